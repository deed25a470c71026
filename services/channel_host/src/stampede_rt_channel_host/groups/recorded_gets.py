"""Gets of recorded channels through a group: they read the archive, and memory, up to the cut."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.errors import Unavailable
from stampede_rt.values.timeline import ResolvedInterval, format_instant
from stampede_rt_channel_host.channels import copied_archives
from stampede_rt_channel_host.channels.group_access import GroupAnswer, GroupReadParams
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import Query
from stampede_rt_channel_host.core.group import Horizon, RecordedView
from stampede_rt_channel_host.groups.hosted_group import NOTHING_VISIBLE


class FoundAnswer(NamedTuple):
    """The answer of a get, and the view that says at which cut the answer changes."""

    answer: GroupAnswer
    view: RecordedView


def reads_archive(params: GroupReadParams, hosted: HostedChannel, query: Query, horizon: Horizon, now: int) -> bool:
    """Whether the answer may have items that only the archive of the channel has.

    Raises StaleBinding (MOVED) if only the owner has the archive.
    """
    recording = hosted.recording
    if params.within_memory:
        return False
    if recording is None:
        copied_archives.check_read(hosted, query, now, horizon)
    return recording is not None and recording.reaches_in_group(query, horizon, now)


async def read_recorded_in_group(
    channels: ChannelStore,
    hosted: HostedChannel,
    query: Query,
    horizon: Horizon,
    within: ResolvedInterval | None,
    *,
    waits: bool,
) -> FoundAnswer:
    """The present answer. `within`: the interval as resolved before; None: not yet."""
    recording = hosted.recording
    assert recording is not None, "the channel is recorded"
    view = await recording.read_in_group(query, horizon, within, channels.scheduler, channels.now, waits=waits)
    return FoundAnswer(GroupAnswer(view.answer, horizon.cut, view.continues), view)


async def read_past_in_group(
    channels: ChannelStore, params: GroupReadParams, hosted: HostedChannel, query: Query
) -> GroupAnswer:
    """The answer as of an earlier instant, at the cut of that instant.

    Raises Unavailable if the archive cannot be read.
    """
    recording, as_of = hosted.recording, params.as_of
    if recording is None or as_of is None:
        raise Unavailable(f"channel {hosted.record.name} is not recorded any more; read again")
    cut = None if params.at == NOTHING_VISIBLE else params.at
    horizon = Horizon(cut, lambda: f"as of {format_instant(as_of)}")
    found = await recording.past_reader().read(query, as_of, channels.scheduler, horizon)
    return GroupAnswer(found.answer, cut, found.continues, found.summary)


def is_over(view: RecordedView, query: Query) -> bool:
    """Whether a get that may wait has its answer."""
    return view.answer.complete or (bool(view.answer.slices) and not query.complete)
