"""The cut of a group as it was at an earlier instant, computed from what its recorded members had accepted by then."""

from __future__ import annotations

import functools
from dataclasses import replace

from stampede_rt._async.channel import Channel
from stampede_rt._async.group_members import GroupMembers
from stampede_rt._async.reads import read
from stampede_rt.errors import InvalidArgument, VersionMismatch
from stampede_rt.transports.concurrency_async import run_all
from stampede_rt.values.grouping import GroupInfo
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval

_NEWEST = ReadQuery(
    parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, limit=1, newest_first=True, payloads=False
)


async def cut_as_of(group: GroupMembers, as_of: int) -> int:
    """Return the cut of a group as of an instant (decision 0229); MIN_INSTANT if the group showed nothing.

    One request to the host of each member, in parallel. Raises InvalidArgument if a member is not recorded, or if the
    rule of the group needs more than the archives have; Unavailable.
    """
    info = group.info
    _check(info)
    counting = [one for one in group.channels if info.reference_id in (None, one.info.channel_id)]
    cuts = await run_all([functools.partial(_cut_of, group, channel, as_of) for channel in counting])
    known = [cut for cut in cuts if cut is not None]
    return min(known) if known and len(known) == len(cuts) else MIN_INSTANT


def _check(info: GroupInfo) -> None:
    """Raise InvalidArgument if the cut depends on more than the archives tell."""
    if info.bound == "end":
        rule = 'bound="end" counts the ends of items that came together, and archives do not tell which did'
    elif info.reference_id is None and info.idle_after_nanos is not None:
        rule = "idle_after left silent members out, and archives do not tell when"
    else:
        return
    raise InvalidArgument(
        f"as_of: the past cuts of group {info.name!r} are not known: {rule}; read the channels themselves"
    )


async def _cut_of(group: GroupMembers, channel: Channel, as_of: int) -> int | None:
    """Return the cut of one member alone; None if it had neither an item nor an advance."""
    found = await read(group.session, channel._state, replace(_NEWEST, as_of=as_of))
    if found.past is None:
        raise VersionMismatch(f"the host of channel {channel.name!r} does not know as_of; upgrade the host")
    marks = [] if found.past.advance is None else [found.past.advance]
    return max([*marks, *found.times], default=None)
