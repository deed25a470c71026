"""Queries about groups: one group with its members, and pages of all groups. Pure. O(page), for any pattern."""

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
    """A group, its existing members in the order of its spec, and their owners, each once."""

    group: GroupRecord
    channels: tuple[ChannelRecord, ...]
    hosts: tuple[HostRecord, ...]


@dataclass(frozen=True, slots=True)
class GroupPage:
    """Groups by name. The next page begins after `last_name`, which is None for the last page."""

    groups: tuple[GroupRecord, ...]
    last_name: str | None


def group_view(tables: Tables, group: GroupRecord) -> GroupView:
    """The view of `group`, which may be an older record. The records of its channels and hosts are the present ones."""
    found = (tables.channels.get(one) for one in group.spec.channel_ids)
    channels = tuple(channel for channel in found if channel is not None)
    host_ids = dict.fromkeys(channel.host_id for channel in channels)
    return GroupView(group, channels, tuple(tables.hosts[one] for one in host_ids))


def group_page(tables: Tables, glob: str, channel_id: bytes, after_name: str, groups_max: int) -> GroupPage:
    """Up to `groups_max` (0: PAGE_SIZE_MAX) groups after `after_name` whose names match `glob`.

    If `channel_id` is not empty, gives only groups with that channel. A page may be short, even empty, and yet not be
    the last. Raises InvalidArgument for an invalid pattern or id.
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
        channel_groups = sorted(group.name for group in tables.groups.with_channel(channel_id))
        return (name for name in channel_groups if name > after_name)
    return queries.names_from(tables.groups.ids, fixed_prefix(glob), after_name)
