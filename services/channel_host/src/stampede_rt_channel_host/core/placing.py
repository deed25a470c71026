"""Chooses hosts for the channels of a host that is drained. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

BUSY_STEP_PERMILLE = 100
"""Hosts whose loads differ by less than this count as equally busy. Of these, the host with the fewest channels gets
the next channels.
"""


class OtherHost(NamedTuple):
    """A live host, with the number of its channels, and the share of a core that it last reported (0: no report).

    `has_archive`: recorded channels can be there.
    """

    host_id: bytes
    name: str
    target: str
    busy_permille: int
    channels: int
    has_archive: bool = False


def connected_sets(groups_of: Mapping[bytes, Collection[bytes]]) -> list[list[bytes]]:
    """The channels in sets. Channels that share a group are in the same set. `groups_of`: by channel, its groups."""
    set_of: dict[bytes, list[bytes]] = {}  # by channel
    sets_by_group: dict[bytes, list[bytes]] = {}
    for channel_id, group_ids in groups_of.items():
        own = set_of[channel_id] = [channel_id]
        for group_id in group_ids:
            other = sets_by_group.setdefault(group_id, own)
            if other is not own:
                for each in own:
                    set_of[each] = other
                other.extend(own)
                sets_by_group.update((one, other) for one, held in sets_by_group.items() if held is own)
                own = other
    return [*{id(one): one for one in set_of.values()}.values()]


def spread(sets: Sequence[Sequence[bytes]], hosts: Sequence[OtherHost]) -> dict[bytes, OtherHost]:
    """A host for each channel. Each of the sets goes to the least busy host. Of equally busy hosts it goes to the host
    with the fewest channels.
    """
    assigned = dict.fromkeys((host.host_id for host in hosts), 0)
    found: dict[bytes, OtherHost] = {}
    for one in sorted(sets, key=len, reverse=True):
        least = min(
            hosts,
            key=lambda host: (host.busy_permille // BUSY_STEP_PERMILLE, host.channels + assigned[host.host_id]),
        )
        assigned[least.host_id] += len(one)
        found |= dict.fromkeys(one, least)
    return found
