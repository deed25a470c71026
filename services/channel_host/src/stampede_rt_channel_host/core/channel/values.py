"""The arguments and results of a channel's methods. Pure.

Every instant is int nanoseconds since the epoch, every duration int nanoseconds, every size bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple, Protocol

from stampede_rt.errors import InvalidArgument, MalformedRun, StampedeError
from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import Interval, Match, ResolvedInterval
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.run import Body, Run, Slice, TimeSpan, time_span
from stampede_rt_channel_host.core.channel.waiting import Needs


@dataclass(frozen=True, kw_only=True, slots=True)
class Offer:
    """A run that a producer wants to put. All columns have the same length, at least 1; -1 marks an absent duration.

    If `times` is None, the channel gives all items one time when it accepts them. `since` is the time at which the
    first item began to wait for room, by the host's clock, or None if it has not waited. If the
    waiting items have no times, the channel treats them as put at `since` when it looks for room. Otherwise a channel
    of one item would never have room.
    """

    times: Sequence[int] | None
    durations: Sequence[int] | None
    lengths: Sequence[int]
    since: int | None = None
    _span: TimeSpan | None = field(default=None, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        items = len(self.lengths)
        if not items:
            raise MalformedRun("the run holds no items; give at least one length")
        for column, values in (("times", self.times), ("durations", self.durations)):
            if values is not None and len(values) != items:
                raise MalformedRun(f"the run has {items} lengths and {len(values)} {column}; give one for each item")

    @property
    def span(self) -> TimeSpan:
        """The span of its times. The run must have times."""
        if self._span is None:
            assert self.times is not None, "the caller has seen that the run has times"
            object.__setattr__(self, "_span", time_span(self.times))
        assert self._span is not None, "it is set now"
        return self._span

    def rest(self, index: int, now: int) -> Offer:
        """The items from position `index` on, to offer again.

        The first of these items waits from `now` on. If it has waited before (`index` is 0 and `since` is set), `since`
        stays the same.
        """
        return Offer(
            times=None if self.times is None else self.times[index:],
            durations=None if self.durations is None else self.durations[index:],
            lengths=self.lengths[index:],
            since=now if self.since is None or index else self.since,
        )


class Seal(Protocol):
    """Makes the stored body of an accepted run. A put calls the seal at most once. The seal must not raise."""

    def __call__(self, first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> Body:
        """The bytes to store.

        `kept` are the accepted positions of the offer; None stands for all positions. `stamped_time` is the time that
        the channel gave the items, or None if the offer had times.
        """


@dataclass(frozen=True, slots=True)
class Rejection:
    """A refused item: its position `index` in the offer and the error (TooOld, InFuture, ItemTooLarge, ChannelFull)."""

    index: int
    error: StampedeError


class PutOutcome(NamedTuple):
    """The outcome of an offer. The channel accepted each item, or refused it with a rejection, or lets it wait.

    `run` holds the accepted items, or is None if there are none. Their seqs begin at `run.first_seq`, in the offer's
    order. `stamped_time` is the time that the channel gave them, or None if the offer had times. The items from
    position `waiting` on must wait (on_full="block"); if `waiting` is None, no item waits. Offer `offer.rest(waiting,
    now)` again after the next change of the channel, and at `retry_at`, if it is set. To stop the wait, call
    `ChannelCore.give_up_put`.
    """

    run: Run | None = None
    stamped_time: int | None = None
    rejections: Sequence[Rejection] = ()
    waiting: int | None = None
    retry_at: int | None = None


class Position(NamedTuple):
    """A position in the order (time, seq). If `seq` is None, the position lies after all items of that time.

    The channel refuses a position of another incarnation. It does not compare `incarnation` 0.
    """

    time: int
    seq: int | None = None
    incarnation: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class SavedCursor:
    """The position from which a subscription continues later. The subscription is done with all seqs below `next_seq`.

    Only items at or above the key `low` belong to the subscription; None stands for all items. In a subscription in seq
    order, `low` applies only to seqs below `live_seq`; all later items belong to the subscription. Only a subscription
    through a group has a `cut`. It is done with seqs below `next_seq` only if their items lie before the cut. The
    channel does not compare `incarnation` 0.
    """

    incarnation: int
    next_seq: int
    low: ItemKey | None = None
    live_seq: int = 0
    cut: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Query:
    """A read (paper, section 3.2). `limit` keeps the earliest items, or with `newest_first` the latest.

    `after` continues after a position in reading order: with later items, or with `newest_first` with earlier items.
    `newer_than` selects only items later than a position, in either order. With `complete` a blocking get waits until
    no more items can come into the interval. `now`: the instant NOW of an earlier page of the answer; None: the clock.
    """

    interval: Interval
    match: Match = Match.SPAN
    limit: int | None = None
    newest_first: bool = False
    after: Position | None = None
    newer_than: Position | None = None
    complete: bool = False
    now: int | None = None

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 1:
            raise InvalidArgument(f"limit is {self.limit}; it is at least 1, or left out for all items")


NO_NEXT_TIMES: Mapping[ItemKey, int] = MappingProxyType({})


class ReadAnswer(NamedTuple):
    """The answer to a read. `slices` ascend in (time, seq), also with `newest_first`.

    `next_time` is the time of the bucket after the last item, or None if the last item is in the newest bucket. The
    reader needs `next_time` to compute the ends of the last spans. `interval` is None if the channel could not resolve
    a meta-time. `complete`: no more items can come into the interval. `truncated`: collected or lost items may
    be missing at the beginning of the interval, or at the beginning of the part that `after` and `newer_than` select.
    `more`: the limit cut items off. `reason` (with its `detail`) says why the answer is empty or partial. `next_times`
    is for channels with overlap. It has an entry for each slice after which the answer leaves items out: the time of
    the bucket after that slice. The key is the time of the slice's last item, and the slice's `end_seq`.
    """

    slices: Sequence[Slice]  # large answers are `SlicesInParts`
    next_time: int | None
    interval: ResolvedInterval | None
    complete: bool
    truncated: bool
    more: bool
    reason: Reason | None
    incarnation: int
    next_times: Mapping[ItemKey, int] = NO_NEXT_TIMES


class WakeAt(NamedTuple):
    """There is no answer yet. Poll again at `instant`, if it is set, and after each change that meets `needs`.

    Other changes cannot release the get. If `needs` is None, any change may release it.
    """

    instant: int | None
    needs: Needs | None = None


class DeliveredSlice(NamedTuple):
    """A slice for a subscriber. `next_time` is the present time of the bucket after the slice's last item.

    `next_time` is None if that item is in the newest bucket.
    """

    slice: Slice
    next_time: int | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """Items that the reader will not get. Their seqs lie between `first_seq` and `last_seq`, both inclusive.

    `items` is the number of these items that belonged to the subscription.
    """

    first_seq: int
    last_seq: int
    items: int
    reason: Reason


@dataclass(frozen=True, kw_only=True, slots=True)
class SubscriptionBatch:
    """The next part of a subscription: first the gap, if there is one, then the slices in seq order.

    If `more` is set, ask for the next part now: the channel has more items to look at. Otherwise wait for a put.
    """

    slices: Sequence[DeliveredSlice] = ()
    gap: Gap | None = None
    more: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to send."""
        return not self.slices and self.gap is None


class GrowingCounts(NamedTuple):
    """The two counts of `Counters` that grow with each accepted item."""

    accepted: int
    accepted_bytes: int


class OtherCounts(NamedTuple):
    """The other counts: refused items, late items, and the items that were not collected for `last_cause`."""

    refused: int
    late: int
    last_cause: str
    collected_otherwise: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Counters:
    """The counts of a channel's items at one moment. Always `accepted == held + sum(collected.values())`.

    `collected` has the keys age, count, bytes, consumption. `rejected` has the keys TOO_OLD, IN_FUTURE, ITEM_TOO_LARGE,
    CHANNEL_FULL, MALFORMED_RUN and OVERLOADED. Bytes are payload bytes. `late` counts the accepted items that came
    after an item with a later time.
    """

    accepted: int
    held: int
    collected: Mapping[str, int]
    rejected: Mapping[str, int]
    accepted_bytes: int
    held_bytes: int
    late: int
