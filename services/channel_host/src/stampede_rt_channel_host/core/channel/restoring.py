"""Takes the newest items of an archive into an empty channel, or frees memory of items that an archive has. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt_channel_host.core.channel.archive_backlog import ArchiveBacklog, low_of
from stampede_rt_channel_host.core.channel.held_items import AGE, ARCHIVE
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.run import Run


def restore(held: Holdings, runs: Iterable[Run], *, after: int | None, next_seq: int) -> None:
    """Store `runs`, which have all items with times later than `after`, in the order of their seqs.

    The items up to `after` count as collected, because the archive has them. If `after` is None, the archive has no
    items besides `runs`. `next_seq`: the seq of the next accepted item.
    """
    if after is not None:
        held.floor = (after, next_seq)  # an item accepted later may have the time `after`, too
        held.newest_collected, held.collected_by = after, ARCHIVE
    for run in runs:
        _skip_to(held, run.first_seq)
        held.store(run, run.payload_bytes(0, len(run)), run.span)
    _skip_to(held, next_seq)
    if after is not None:
        held.collected_end = after + 1 if held.oldest is None else held.oldest


def leave_to_archive(held: Holdings, edge: int, backlog: ArchiveBacklog | None, clock: int) -> bool:
    """Collect from memory all items up to the time `edge`, so that only the archive has them. Later items stay.

    Returns False, and collects nothing, if the archive does not have all of them yet. Call it again after the next
    write of the archive. Meanwhile the channel refuses items before `edge`.
    """
    held.newest_collected = edge if held.newest_collected is None else max(edge, held.newest_collected)
    low = low_of(backlog)
    if low is not None and low[0] <= edge:
        return False
    held.outdate(held.oldest_before(edge + 1), AGE, clock)
    held.floor = max(held.floor, (edge, held.next_seq))  # an item accepted later may have the time `edge`, too
    held.collected_by = ARCHIVE
    held.collected_end = edge + 1 if held.oldest is None else held.oldest
    return True


def _skip_to(held: Holdings, next_seq: int) -> None:
    """Pass the seqs up to `next_seq`, exclusive, unless they are held or were passed before."""
    held.passed_seqs += max(0, next_seq - held.next_seq)
