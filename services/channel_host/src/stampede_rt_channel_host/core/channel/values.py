"""The values that callers give a channel and get back from it. Pure.

Every instant is int nanoseconds since the epoch, every duration int nanoseconds, every size bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from stampede_rt.errors import InvalidArgument, MalformedRun, StampedeError
from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import Interval, Match, ResolvedInterval
from stampede_rt_channel_host.core.channel.index import ItemKey
from stampede_rt_channel_host.core.channel.run import Run, Slice
from stampede_rt_channel_host.core.channel.waiting import Needs


@dataclass(frozen=True, kw_only=True, slots=True)
class Offer:
    """A run that asks to be put. All columns have the same length, at least 1; -1 marks an absent duration.

    `times` None: the channel stamps all items with one time when it accepts them. `since`: since when such items wait
    (the host's clock); room is judged as if they had been put then, or else a channel of one item never had any.
    """

    times: Sequence[int] | None
    durations: Sequence[int] | None
    lengths: Sequence[int]
    since: int | None = None

    def __post_init__(self) -> None:
        items = len(self.lengths)
        if not items:
            raise MalformedRun("the run holds no items; give at least one length")
        for column, values in (("times", self.times), ("durations", self.durations)):
            if values is not None and len(values) != items:
                raise MalformedRun(f"the run has {items} lengths and {len(values)} {column}; give one for each item")

    def rest(self, index: int, now: int) -> Offer:
        """The items from position `index` on, to offer again. They wait from `now` on, unless they did before."""
        return Offer(
            times=None if self.times is None else self.times[index:],
            durations=None if self.durations is None else self.durations[index:],
            lengths=self.lengths[index:],
            since=now if self.since is None or index else self.since,
        )


class Seal(Protocol):
    """Makes the bytes of a run that is about to be stored; called once, at the most, by a put. Must not raise."""

    def __call__(self, first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
        """`kept`: the accepted positions of the offer, None for all; `stamped_time`: set if it had no times."""


@dataclass(frozen=True, slots=True)
class Rejection:
    """An item that was refused: its position in the offer and why (TooOld, InFuture, ItemTooLarge, ChannelFull)."""

    index: int
    error: StampedeError


class PutOutcome(NamedTuple):
    """The outcome of an offer. Items before `waiting` (all, if None) were accepted, or refused with a rejection.

    `run` holds the accepted ones (None: none); their seqs are `run.first_seq` and on, in the offer's order. Those from
    position `waiting` on must wait (on_full="block"): offer `offer.rest(waiting, now)` again after the next change of
    the channel and at `retry_at`, if there is such an instant; to stop waiting, `ChannelCore.give_up_put`.
    """

    run: Run | None = None
    stamped_time: int | None = None
    rejections: Sequence[Rejection] = ()
    waiting: int | None = None
    retry_at: int | None = None


class Position(NamedTuple):
    """A position in the order (time, seq). `seq` None: behind all items of that time. `incarnation` 0: not compared."""

    time: int
    seq: int | None = None
    incarnation: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class SavedCursor:
    """Where a subscription stands, to go on from later: everything below `next_seq` was dealt with.

    `low`: only items at or above this key are meant; of those with `live_seq` or a later one, in seq order, all are.
    `cut`: through a group, what lies below it and below `next_seq` was dealt with. `incarnation` 0: not compared.
    """

    incarnation: int
    next_seq: int
    low: ItemKey | None = None
    live_seq: int = 0
    cut: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Query:
    """A read (paper, section 3.2). `limit` keeps the earliest, or with `newest_first` the latest.

    `after` continues behind a position in reading order: later items, or with `newest_first` earlier ones.
    `newer_than` selects only items later than a position, whatever the order. `complete` makes a blocking get wait
    until the interval is finished.
    """

    interval: Interval
    match: Match = Match.SPAN
    limit: int | None = None
    newest_first: bool = False
    after: Position | None = None
    newer_than: Position | None = None
    complete: bool = False

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 1:
            raise InvalidArgument(f"limit is {self.limit}; it is at least 1, or left out for all items")


class ReadAnswer(NamedTuple):
    """The answer to a read. `slices` ascend in (time, seq), also with `newest_first`.

    `next_time` is the time of the bucket behind the last item, None if that one is in the newest: with it a reader
    derives every span's end. `interval` is None if a meta-time could not be resolved. `complete`: nothing more can
    come; `truncated`: the lower bound lies below the frontier; `more`: the limit cut it. `reason` (with its `detail`)
    says why the answer is empty or partial.
    """

    slices: Sequence[Slice]  # many are `Gathered`
    next_time: int | None
    interval: ResolvedInterval | None
    complete: bool
    truncated: bool
    more: bool
    reason: Reason | None
    incarnation: int


class WakeAt(NamedTuple):
    """Nothing to answer yet: poll again at `instant`, if it is set, and after the changes of the channel that come so
    far as `needs`: others cannot release the get. None: any may."""

    instant: int | None
    needs: Needs | None = None


class DeliveredSlice(NamedTuple):
    """A slice for a subscriber, with the time of the bucket behind its last item as known now (None: the newest)."""

    slice: Slice
    next_time: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """Seqs `first_seq` to `last_seq` will not be sent; `items` of them were for this subscription."""

    first_seq: int
    last_seq: int
    items: int
    reason: Reason


@dataclass(frozen=True, kw_only=True, slots=True)
class SubscriptionBatch:
    """The next part of a subscription: first the gap, if any, then the slices in seq order. `more`: there is more to
    look at; take again soon."""

    slices: Sequence[DeliveredSlice] = ()
    gap: Gap | None = None
    more: bool = False

    @property
    def is_empty(self) -> bool:
        """There is nothing to send; unless there is `more`, wait for the next put."""
        return not self.slices and self.gap is None


@dataclass(frozen=True, kw_only=True, slots=True)
class Counters:
    """The counts of a channel's items at one moment: `accepted == held + sum(collected.values())`, always.

    `collected` has the keys age, count, bytes, consumption; `rejected` TOO_OLD, IN_FUTURE, ITEM_TOO_LARGE,
    CHANNEL_FULL, MALFORMED_RUN. Bytes are payload bytes.
    """

    accepted: int
    held: int
    collected: Mapping[str, int]
    rejected: Mapping[str, int]
    accepted_bytes: int
    held_bytes: int
