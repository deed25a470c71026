"""The arguments and results of a channel's methods. Pure.

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
    """A run that a producer wants to put. All columns have the same length, at least 1; -1 marks an absent duration.

    `times` None: the channel stamps all items with one time when it accepts them. `since`: when the first item began to
    wait for room, by the host's clock; None: it has not waited. The channel judges the room for items without times as
    if they had been put then. Otherwise a channel of one item would never have room.
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
        """The items from position `index` on, to offer again.

        The first of them waits from `now` on. If it waited already (`index` 0), the start of its wait stays the same.
        """
        return Offer(
            times=None if self.times is None else self.times[index:],
            durations=None if self.durations is None else self.durations[index:],
            lengths=self.lengths[index:],
            since=now if self.since is None or index else self.since,
        )


class Seal(Protocol):
    """Makes the stored bytes of an accepted run. A put calls it once at the most. It must not raise."""

    def __call__(self, first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
        """The bytes to store.

        `kept`: the accepted positions of the offer, None for all. `stamped_time`: the time of all items, if the
        offer had no times; else None.
        """


@dataclass(frozen=True, slots=True)
class Rejection:
    """A refused item: its position in the offer and the error (TooOld, InFuture, ItemTooLarge, ChannelFull)."""

    index: int
    error: StampedeError


class PutOutcome(NamedTuple):
    """The outcome of an offer. Each item before `waiting` (each item, if None) was accepted, or refused with a
    rejection.

    `run` holds the accepted items, None if there are none. Their seqs begin at `run.first_seq`, in the offer's order.
    The items from position `waiting` on must wait (on_full="block"). Offer `offer.rest(waiting, now)` again after the
    next change of the channel, and at `retry_at`, if it is set. To stop the wait, call `ChannelCore.give_up_put`.
    """

    run: Run | None = None
    stamped_time: int | None = None
    rejections: Sequence[Rejection] = ()
    waiting: int | None = None
    retry_at: int | None = None


class Position(NamedTuple):
    """A position in the order (time, seq). `seq` None: after all items of that time. `incarnation` 0: not compared."""

    time: int
    seq: int | None = None
    incarnation: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class SavedCursor:
    """The place from which a subscription continues later: all items below `next_seq` are done.

    `low`: only items at or above this key belong to the subscription. In a subscription in seq order, `low` applies
    only to seqs below `live_seq`; all later items belong to it. `cut`: only for a subscription through a group. The
    items that lie before the cut and have seqs below `next_seq` are done. `incarnation` 0: not compared.
    """

    incarnation: int
    next_seq: int
    low: ItemKey | None = None
    live_seq: int = 0
    cut: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Query:
    """A read (paper, section 3.2). `limit` keeps the earliest items, or with `newest_first` the latest.

    `after` continues after a position in reading order: with later items, or with `newest_first` with earlier ones.
    `newer_than` selects only items later than a position, in either order. `complete` makes a blocking get wait until
    the interval is finished.
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

    `next_time` is the time of the bucket after the last item, None if the last item is in the newest bucket. A reader
    computes every span's end from it. `interval` is None if a meta-time could not be resolved. `complete`: no more
    items can come. `truncated`: the interval, or the part of it that `after` and `newer_than` leave, begins where
    items are missing, because they were collected or lost. `more`: the limit cut items off. `reason` (with its
    `detail`) says why the answer is empty or partial.
    """

    slices: Sequence[Slice]  # large answers are `Gathered`
    next_time: int | None
    interval: ResolvedInterval | None
    complete: bool
    truncated: bool
    more: bool
    reason: Reason | None
    incarnation: int


class WakeAt(NamedTuple):
    """There is no answer yet: poll again at `instant`, if it is set, and after the changes that reach `needs`.

    Other changes cannot release the get. `needs` None: any change may.
    """

    instant: int | None
    needs: Needs | None = None


class DeliveredSlice(NamedTuple):
    """A slice for a subscriber, and the present time of the bucket after its last item (None: that item is in the
    newest bucket).
    """

    slice: Slice
    next_time: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """Items that the reader will not get: `items` of the seqs from `first_seq` to `last_seq` belonged to the
    subscription.
    """

    first_seq: int
    last_seq: int
    items: int
    reason: Reason


@dataclass(frozen=True, kw_only=True, slots=True)
class SubscriptionBatch:
    """The next part of a subscription: first the gap, if any, then the slices in seq order.

    `more`: there are more items to look at, so ask for the next part without a wait for a put.
    """

    slices: Sequence[DeliveredSlice] = ()
    gap: Gap | None = None
    more: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to send. Then wait for the next put, unless `more` is set."""
        return not self.slices and self.gap is None


@dataclass(frozen=True, kw_only=True, slots=True)
class Counters:
    """The counts of a channel's items at one moment. Always `accepted == held + sum(collected.values())`.

    `collected` has the keys age, count, bytes, consumption. `rejected` has the keys TOO_OLD, IN_FUTURE, ITEM_TOO_LARGE,
    CHANNEL_FULL, MALFORMED_RUN and OVERLOADED. Bytes are payload bytes.
    """

    accepted: int
    held: int
    collected: Mapping[str, int]
    rejected: Mapping[str, int]
    accepted_bytes: int
    held_bytes: int
