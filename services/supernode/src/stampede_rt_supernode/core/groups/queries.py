"""Questions about groups: one with its members, and pages of many. Pure; O(page), and bounded whatever the pattern."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stampede_rt_supernode.core import queries
from stampede_rt_supernode.core.glob import fixed_prefix, matcher
from stampede_rt_supernode.core.records import ChannelRecord, GroupRecord, HostRecord
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id


@dataclass(frozen=True, slots=True)
class GroupView:
    """A group, those of its members that are there, in the order of its set-up, and their owners, each once."""

    group: GroupRecord
    channels: tuple[ChannelRecord, ...]
    hosts: tuple[HostRecord, ...]


@dataclass(frozen=True, slots=True)
class GroupPage:
    """Groups in the order of names. `last_name`: the next page begins behind it; None: this was the last."""

    groups: tuple[GroupRecord, ...]
    last_name: str | None


def group_view(tables: Tables, group: GroupRecord) -> GroupView:
    """`group` may be as it was earlier; its members are as they are now."""
    found = (tables.channels.get(one) for one in group.spec.channel_ids)
    channels = tuple(channel for channel in found if channel is not None)
    host_ids = dict.fromkeys(channel.host_id for channel in channels)
    return GroupView(group, channels, tuple(tables.hosts[one] for one in host_ids))


def group_page(tables: Tables, glob: str, channel_id: bytes, after_name: str, groups_max: int) -> GroupPage:
    """Up to `groups_max` (0: the most) groups behind `after_name` whose names match, of one channel if there is an id.

    A page may be short, even empty, and yet not be the last. Raises InvalidArgument for a bad pattern or id.
    """
    matches, limit = matcher(glob), min(groups_max or queries.PAGE_SIZE_MAX, queries.PAGE_SIZE_MAX)
    found: list[GroupRecord] = []
    last_name = None
    for examined, name in enumerate(_names(tables, glob, channel_id, after_name), start=1):
        if len(found) == limit or examined > queries.NAMES_EXAMINED_MAX:
            return GroupPage(tuple(found), last_name)
        last_name = name
        if matches(name):
            found.append(tables.groups.by_id[tables.groups.ids[name]])
    return GroupPage(tuple(found), None)


def _names(tables: Tables, glob: str, channel_id: bytes, after_name: str) -> Iterator[str]:
    if channel_id:
        check_id(channel_id, "channel_id")
        of_channel = sorted(group.name for group in tables.groups.with_channel(channel_id))
        return (name for name in of_channel if name > after_name)
    return queries.names_from(tables.groups.ids, fixed_prefix(glob), after_name)
