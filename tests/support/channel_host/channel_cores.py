"""Short functions that make and inspect a channel core."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, BoundLike, Match, parse_interval
from stampede_rt_channel_host.core.channel import ChannelCore, Offer, PutOutcome, Query, ReadAnswer, Slice

CLOCK = 1_000_000


def a_channel(clock_ahead: int = 10**6, **policy: int | str | None) -> ChannelCore:
    """Return a channel that accepts times near CLOCK, unless the policy states other limits."""
    return ChannelCore(Policy(**{"max_future_nanos": clock_ahead, **policy}), incarnation=3, name="cam/left")  # type: ignore[arg-type]


def seal(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
    return f"{first_seq} {kept} {stamped_time}".encode()


def put(
    channel: ChannelCore,
    *times: int,
    now: int = CLOCK,
    durations: Sequence[int] | None = None,
    lengths: Sequence[int] | None = None,
) -> PutOutcome:
    columns = Offer(times=list(times), durations=durations, lengths=lengths or [10] * len(times))
    return channel.put(columns, now, seal)


def get(
    channel: ChannelCore,
    start: BoundLike = MIN_INSTANT,
    end: BoundLike = MAX_INSTANT,
    bounds: str = "[]",
    *,
    now: int = CLOCK,
    match: Match = Match.SPAN,
    limit: int | None = None,
    newest_first: bool = False,
) -> ReadAnswer:
    interval = parse_interval(start, end, bounds)
    return channel.read(Query(interval=interval, match=match, limit=limit, newest_first=newest_first), now)


def times_of(slices: Sequence[Slice]) -> list[int]:
    return [time for part in slices for time in part.run.times[part.lo : part.hi]]


def seqs_of(slices: Sequence[Slice]) -> list[int]:
    return [seq for part in slices for seq in range(part.first_seq, part.end_seq)]
