"""Pages of the directory's channels and hosts. Pure. A page of channels takes O(page)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sortedcontainers import SortedDict

from stampede_rt_supernode.core.glob import fixed_prefix, matcher
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord
from stampede_rt_supernode.core.tables import Tables

PAGE_SIZE_MAX = 1000
NAMES_EXAMINED_MAX = 5_000  # for one page, so that a pattern with few matches does not hold up other work
HOST_CHANNELS_MAX = 1000


@dataclass(frozen=True, slots=True)
class ChannelPage:
    """Channels by name. The next page begins after `last_name`, which is None for the last page."""

    channels: tuple[ChannelRecord, ...]
    last_name: str | None


@dataclass(frozen=True, slots=True)
class HostPage:
    """Hosts by (name, id). The next page begins after `last_key`, which is None for the last page."""

    hosts: tuple[HostRecord, ...]
    last_key: tuple[str, bytes] | None


def channel_page(tables: Tables, glob: str, after_name: str, channels_max: int) -> ChannelPage:
    """Up to `channels_max` (0: PAGE_SIZE_MAX) channels after `after_name` whose names match `glob`.

    A page may be short, even empty, and yet not be the last. Raises InvalidArgument for an invalid pattern.
    """
    matches, limit = matcher(glob), min(channels_max or PAGE_SIZE_MAX, PAGE_SIZE_MAX)
    found: list[ChannelRecord] = []
    last_name = None
    names = names_from(tables.channel_ids, fixed_prefix(glob), after_name)
    for examined, name in enumerate(names, start=1):
        if len(found) == limit or examined > NAMES_EXAMINED_MAX:
            return ChannelPage(tuple(found), last_name)
        last_name = name
        if matches(name):
            found.append(tables.channels[tables.channel_ids[name]])
    return ChannelPage(tuple(found), None)


def names_from(ids: SortedDict[str, bytes], prefix: str, after_name: str) -> Iterator[str]:
    """The names in `ids` that begin with `prefix` and come after `after_name`, in ascending order."""
    first = max(prefix, after_name)
    for name in ids.irange(minimum=first, inclusive=(first != after_name, True)):
        if not name.startswith(prefix):
            return
        yield name


def host_page(
    tables: Tables, after_key: tuple[str, bytes], hosts_max: int, *, include_dead: bool, lost_since: int = 0
) -> HostPage:
    """Up to `hosts_max` (0: PAGE_SIZE_MAX) hosts after `after_key`. O(all hosts).

    `include_dead`: returns also hosts without a lease that still own a channel or queue, or whose lease ended at
    `lost_since` (Unix nanoseconds) or later.
    """
    limit = min(hosts_max or PAGE_SIZE_MAX, PAGE_SIZE_MAX)
    dead = (one for one in tables.hosts.values() if not one.alive and _is_of_interest(tables, one, lost_since))
    hosts = [*tables.live_hosts(), *(dead if include_dead else ())]
    keys = sorted(key for host in hosts if (key := (host.name, host.host_id)) > after_key)
    page = tuple(tables.hosts[host_id] for _, host_id in keys[:limit])
    return HostPage(page, keys[limit - 1] if len(keys) > limit else None)


def _is_of_interest(tables: Tables, host: HostRecord, lost_since: int) -> bool:
    if host.channels or tables.queues.count_at(host.host_id):
        return True
    return host.lease_ended_unix_nano is not None and host.lease_ended_unix_nano >= lost_since


def channels_of(tables: Tables, host_id: bytes) -> tuple[ChannelRecord, ...]:
    """The channels that a host owns: the first HOST_CHANNELS_MAX in the order of their ids."""
    return tuple(tables.channels_at(host_id, HOST_CHANNELS_MAX))
