"""Takes the newest archived items of a channel into its memory, when its host begins to serve it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeGuard

from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.segment_files import OpenedArchive
from stampede_rt_channel_host.core.archive import ArchiveWindow, Segment, span_of
from stampede_rt_channel_host.core.channel import FIRST_KEY, Acceptances, ChannelCore, Run, Slice, make_run
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY


def restore_channel(
    channel: ChannelCore,
    found: OpenedArchive,
    newest: ArchiveWindow | None,
    cut: Callable[[bytes, int, int], bytes],
    begin: int = 1,
) -> int:
    """Take the newest archived items into memory, so that the channel continues where its archive ends. Returns the seq
    after the archived items.

    Leaves all items up to the last hole to the archive: only reads of the archive say LOST for a hole. A channel that
    stopped before its first item has a note of the stop, and no items.

    `begin`: the first seq of this owner if a former owner was lost. The host of the former owner may bring more of its
    items to the archive later.
    """
    window, segments = newest or ArchiveWindow(ChannelIndex(), None, None, None), found.segments
    after = _left_to_archive(window, span_of(segments).newest)
    low = FIRST_KEY if after is None else (after + 1, 0)
    parts = sorted(window.items.slices(low, LAST_KEY), key=lambda one: one.first_seq)
    runs = [part.run if part.is_whole else _cut(part, cut) for part in parts]
    first = segments[0].first_seq if segments else 1
    if after is None and first > 1 and runs:
        after = min(min(run.times) for run in runs) - 1
    stop, end_seq = found.stop, max((one.end_seq for one in segments), default=1)
    loss = _loss(channel, found, window, end_seq)
    advance = stop.advance if stop is not None and stop.incarnation == channel.incarnation else None
    found_to = end_seq if stop is None else max(end_seq, stop.end_seq)
    next_seq = max(found_to, begin) if lacks_loss(loss[1], found) else found_to
    channel.restore(runs, after=after, next_seq=next_seq, loss=loss, advance=advance)
    return found_to


def restore_instants(channel: ChannelCore, newest: ArchiveWindow | None, now: int) -> None:
    """Note when the items of `newest`, which memory holds now, were accepted. The clock may have gone back since."""
    channel.acceptances = Acceptances()
    if newest is not None and newest.accepted is not None:
        channel.acceptances.take(newest.accepted, now, channel.held)


def lacks_loss(lost_before: int | None, found: OpenedArchive) -> TypeGuard[int]:
    """Whether the archive does not say yet that items before `lost_before` were lost. A former owner that stopped
    cleanly has written it with its first items.
    """
    if lost_before is None:
        return False
    return found.stop is None or all(one.last_accepted < lost_before for one in found.segments)


def _loss(
    channel: ChannelCore, found: OpenedArchive, window: ArchiveWindow, end_seq: int
) -> tuple[int | None, int | None]:
    """Return `lost_from` and `lost_before`, see `QueryReader`. `end_seq`: the end of the segments."""
    since = _lost_since(found.segments, window)
    return (since, channel.lost_before) if found.stop is None else loss_after(found.stop, since, end_seq)


def loss_after(stop: CleanStop, since: int | None, end_seq: int) -> tuple[int | None, int | None]:
    """Return `lost_from` and `lost_before` after a clean stop of the last owner.

    `since`: the instant from which on items behind `end_seq` may lie.
    """
    if stop.newest is None or end_seq >= stop.end_seq:
        return stop.lost_from, stop.lost_before
    if stop.lost_before is None:  # the last block is damaged, or the last object is missing
        return since, stop.newest + 1
    lost_before = max(stop.lost_before, stop.newest + 1)
    if since is None or stop.lost_from is None:
        return None, lost_before
    return min(since, stop.lost_from), lost_before


def lost_since(segments: Sequence[Segment]) -> int | None:
    """The earliest instant at which items behind these segments may lie; None: any instant.

    The newest item may have a time in the future. Then the items after it have the time of their acceptance.
    """
    newest = span_of((*segments,)).newest
    return None if newest is None else min(newest, max(one.last_accepted for one in segments))


def _lost_since(segments: Sequence[Segment], window: ArchiveWindow) -> int | None:
    """Return `lost_since`, or a later instant: the time of the latest item in `window` that is not in the future.

    `window`: the newest items.
    """
    since = lost_since(segments)
    earlier = None if since is None else window.items.last_time_up_to(since)
    return since if earlier is None else earlier


def _left_to_archive(window: ArchiveWindow, newest: int | None) -> int | None:
    """The time up to which all items stay in the archive only, or None if memory takes all of them.

    The hole of a lost host may end after the time of the `newest` item, because later items may have earlier times.
    The channel still takes items that are later than `newest`.
    """
    ends = [hole.end for hole in window.holes]
    last = max(ends if window.edge is None else [*ends, window.edge], default=None)
    return last if last is None or newest is None else min(last, newest)


def _cut(part: Slice, cut: Callable[[bytes, int, int], bytes]) -> Run:
    """The items of a slice as a run of their own."""
    run, lo, hi = part
    durations = None if run.durations is None else run.durations[lo:hi]
    return make_run(part.first_seq, run.times[lo:hi], durations, run.lengths[lo:hi], cut(bytes(run.body), lo, hi))
