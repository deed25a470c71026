"""Gets that reach further back than the items in memory: they read windows of the channel's archive."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_channel_host.channels.gets.open_get import OpenGet
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.channel import PendingGet, ReadAnswer


async def read_recorded(get: OpenGet, scheduler: PieceScheduler, now: Callable[[], int]) -> ReadAnswer | PendingGet:
    """The answer of a get over the archive and memory.

    A get that may wait, and whose items have not come, gets its interval instead (`get.pending`). The caller lets the
    get wait until memory has an answer, and then calls again.
    """
    recording, query = get.hosted.recording, get.plan.query
    assert recording is not None, "the channel is recorded"
    if get.plan.as_of is not None:
        found = await recording.past_reader().read(query, get.plan.as_of, scheduler)
        get.continues, get.past = found.continues, found.summary
        return found.answer
    within = None if get.pending is None else get.pending.interval
    read = await recording.read(query, within, scheduler, now)
    get.continues = read.continues
    answer = read.answer()
    is_over = answer.complete or get.waits_for_archive or not get.plan.wait_nanos
    if is_over or (answer.slices and not query.complete):
        return answer
    get.continues, get.waits_for_archive = False, True
    get.pending = PendingGet(query, read.within)
    return get.pending
