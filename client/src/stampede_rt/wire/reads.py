"""Converts the parts of reads to and from protobuf: bounds, intervals, match modes, positions, past states, reasons.

The messages are in `time.proto`, `item.proto`, `channel_service.proto` and `error.proto`.
"""

from __future__ import annotations

from functools import lru_cache

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2, error_pb2, item_pb2, time_pb2
from stampede_rt.values.answers import PastState
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.timeline import Bound, Interval, Match, MetaTime, ResolvedInterval

INTERVALS_KEPT_MAX = 256
_TO_META = {
    MetaTime.NOW: time_pb2.META_TIME_NOW,
    MetaTime.NEWEST: time_pb2.META_TIME_NEWEST,
    MetaTime.OLDEST: time_pb2.META_TIME_OLDEST,
}
_FROM_META = {value: key for key, value in _TO_META.items()}
_TO_MATCH = {Match.SPAN: time_pb2.MATCH_SPAN, Match.WHOLE: time_pb2.MATCH_WHOLE, Match.START: time_pb2.MATCH_START}
_FROM_MATCH = {value: key for key, value in _TO_MATCH.items()} | {time_pb2.MATCH_UNSPECIFIED: Match.SPAN}
_REASON_PREFIX = "ABSENCE_REASON_"


def bound_to_message(bound: Bound, *, exclusive: bool = False) -> time_pb2.Bound:
    """Return the message for one bound of an interval."""
    if bound.meta is None:
        return time_pb2.Bound(instant_unix_nano=bound.offset, exclusive=exclusive)
    return time_pb2.Bound(meta_time=_TO_META[bound.meta], offset_nanos=bound.offset, exclusive=exclusive)


def bound_from_message(message: time_pb2.Bound, what: str) -> Bound:
    """Return one bound of an interval. Raises InvalidArgument if the message has neither an instant nor a meta-time.

    `what` names the bound in the error.
    """
    anchor = message.WhichOneof("anchor")
    if anchor == "instant_unix_nano":
        return Bound(None, message.instant_unix_nano + message.offset_nanos)
    if anchor is None or message.meta_time not in _FROM_META:
        raise InvalidArgument(f"{what} has no anchor; set instant_unix_nano or a meta_time")
    return Bound(_FROM_META[message.meta_time], message.offset_nanos)


@lru_cache(INTERVALS_KEPT_MAX)  # intervals repeat: each read of the newest item asks for all time
def interval_to_message(interval: Interval) -> time_pb2.Interval:
    """Return the message for an interval. The caller must not change the message, because later callers get it, too."""
    return time_pb2.Interval(
        start=bound_to_message(interval.start, exclusive=interval.start_exclusive),
        end=bound_to_message(interval.end, exclusive=interval.end_exclusive),
    )


def interval_from_message(message: time_pb2.Interval) -> Interval:
    """Return an interval, from its message. Raises InvalidArgument, InvalidInterval."""
    return Interval(
        bound_from_message(message.start, "the interval's start"),
        bound_from_message(message.end, "the interval's end"),
        message.start.exclusive,
        message.end.exclusive,
    )


def past_from_message(message: channel_service_pb2.PastSummary) -> PastState:
    """Return the facts about a channel as it was at an earlier instant."""
    return PastState(
        message.advance_unix_nano if message.HasField("advance_unix_nano") else None,
        message.next_change_unix_nano if message.HasField("next_change_unix_nano") else None,
        (message.next_seq, message.next_start_unix_nano, message.next_end_unix_nano)
        if message.HasField("next_seq")
        else None,
    )


def match_to_message(match: Match) -> time_pb2.Match:
    """Return the message for the rule by which an interval selects items."""
    return _TO_MATCH[match]


def match_from_message(match: int) -> Match:
    """Return the rule by which an interval selects items. Raises InvalidArgument for an unknown number."""
    try:
        return _FROM_MATCH[match]  # type: ignore[index]
    except KeyError:
        raise InvalidArgument(f"match is {match}; use a value of stampede_rt.v1.Match") from None


def position_of(after: Item | int) -> item_pb2.ItemPosition:
    """Return the position of an item. For an instant, return the position after all items of that instant.

    Raises InvalidArgument for an item that no channel can have.
    """
    if isinstance(after, Item):
        check_item(after)
        return item_pb2.ItemPosition(time_unix_nano=after.time, seq=after.seq, incarnation=after.incarnation)
    return item_pb2.ItemPosition(time_unix_nano=after)


def check_item(item: Item) -> None:
    """Raise InvalidArgument if no channel can have the time, seq or incarnation of an item.

    For example, a program may have changed a copy of an item.
    """
    for what, value, least, end in (
        ("time", item.time, -(2**63), 2**63),
        ("seq", item.seq, 0, 2**64),
        ("incarnation", item.incarnation, 0, 2**64),
    ):
        if not isinstance(value, int) or not least <= value < end:
            raise InvalidArgument(f"the item's {what} is {value!r}; give an item as a read or a put returned it")


def resolved_to_message(interval: ResolvedInterval) -> time_pb2.ResolvedInterval:
    """Return the message for an interval that a host has resolved."""
    return time_pb2.ResolvedInterval(
        start_unix_nano=interval.start,
        end_unix_nano=interval.end,
        start_exclusive=interval.start_exclusive,
        end_exclusive=interval.end_exclusive,
    )


def resolved_from_message(message: time_pb2.ResolvedInterval) -> ResolvedInterval:
    """Return an interval that a host has resolved, from its message."""
    return ResolvedInterval(
        message.start_unix_nano, message.end_unix_nano, message.start_exclusive, message.end_exclusive
    )


def reason_to_message(reason: Reason | None) -> str:
    """Return the name of the AbsenceReason for `reason`; for None, the name of the unspecified one.

    The detail of the reason has a field of its own in each message.
    """
    return _REASON_PREFIX + (reason.value if reason else "UNSPECIFIED")


def reason_from_message(reason: int, detail: str) -> Reason | None:
    """Return the reason why an answer is empty or partial; None if nothing is missing."""
    if reason == error_pb2.ABSENCE_REASON_UNSPECIFIED:
        return None
    known = error_pb2.AbsenceReason.DESCRIPTOR.values_by_number.get(reason)
    name = "UNKNOWN" if known is None else known.name  # only newer hosts know this reason: the detail explains it
    return Reason(name.removeprefix(_REASON_PREFIX), detail)


def summary_reason(summary: channel_service_pb2.GetSummary) -> Reason | None:
    """Return the reason why the answer of a get is empty or partial; None if nothing is missing."""
    reason = reason_from_message(summary.reason, summary.detail)
    if reason is not None and summary.HasField("lost_before_unix_nano"):
        reason.before = summary.lost_before_unix_nano
    return reason
