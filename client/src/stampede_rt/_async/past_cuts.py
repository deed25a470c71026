"""The cut of a group as it was at an earlier instant, computed from the items that its members had accepted by then."""

from __future__ import annotations

import functools
from dataclasses import replace

from stampede_rt._async.channel import Channel
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.present_cuts import confirm_members
from stampede_rt._async.reads import read_as_of
from stampede_rt._async.session import Session
from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.transports.concurrency_async import run_all
from stampede_rt.values.answers import PastState
from stampede_rt.values.grouping import GroupInfo
from stampede_rt.values.model import Reason
from stampede_rt.values.past import PastCut, PastMark, past_cut_of
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval

_NEWEST = ReadQuery(
    parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, limit=1, newest_first=True, payloads=False
)


async def cut_as_of(group: GroupMembers, as_of: int) -> PastCut:
    """Return the cut of a group as of an instant (decision 0229).

    The client first asks one host for the present members. Then it asks the hosts of all members that decide the cut,
    in parallel. Raises InvalidArgument if a member is not recorded, or if the rule of the group needs more than the
    archives have; PermissionDenied if the caller may not read one of these members; Unavailable.
    """
    await _confirm(group)
    _check(group.info)
    counting = counting_members(group)
    marks = await run_all([functools.partial(_mark_in_group, group, channel, as_of) for channel in counting])
    return past_cut_of(marks)


def counting_members(group: GroupMembers) -> list[Channel]:
    """Return the members that decide the cut: the reference, or all."""
    return [one for one in group.channels if group.info.reference_id in (None, one.info.channel_id)]


def _check(info: GroupInfo) -> None:
    """Raise InvalidArgument if the cut depends on facts that the archives do not have."""
    if info.bound == "end":
        rule = 'bound="end" counts the ends of items that came together, and archives do not show which items these are'
    elif info.reference_id is None and info.idle_after_nanos is not None:
        rule = "idle_after left silent members out, and archives do not show when"
    else:
        return
    raise InvalidArgument(
        f"as_of: the past cuts of group {info.name!r} are not known: {rule}; read the channels themselves"
    )


async def _confirm(group: GroupMembers) -> None:
    member = counting_members(group)[0]
    try:
        await confirm_members(group, member)
    except PermissionDenied as error:
        raise _denied(group, member, error) from None


async def _mark_in_group(group: GroupMembers, channel: Channel, as_of: int) -> PastMark:
    try:
        return await _mark_as_of(group.session, channel, as_of)
    except PermissionDenied as error:
        raise _denied(group, channel, error) from None


def _denied(group: GroupMembers, channel: Channel, error: PermissionDenied) -> PermissionDenied:
    """Return the error that names the group, and the channel that the caller has no right to read."""
    return PermissionDenied(
        f"as_of: the earlier cut of group {group.name!r} needs the right to read its channel {channel.name!r}: "
        f"{error}; get that right, or read the other channels without the group",
        metadata=error.metadata,
    )


async def _mark_as_of(session: Session, channel: Channel, as_of: int) -> PastMark:
    """Return how far a channel had come at an instant, according to its archive."""
    found = await read_as_of(session, channel._state, _NEWEST, as_of)
    reason = found.reason if found.reason == "LOST" or (found.reason == "COLLECTED" and not found) else None
    if reason is None and found and found.truncated:
        reason = await _lost_since(session, channel, found[0].time, as_of)
    past = found.past or PastState(None, None, None)
    return PastMark(channel.name, max(found.times, default=None), past.advance, reason, past.next_change)


async def _lost_since(session: Session, channel: Channel, newest: int, as_of: int) -> Reason | None:
    """Return the reason if items later than the newest one may have been lost with a host; otherwise None."""
    query = replace(_NEWEST, interval=parse_interval(newest, MAX_INSTANT, "(]"))
    items = await read_as_of(session, channel._state, query, as_of)
    return items.reason if items.reason == "LOST" else None
