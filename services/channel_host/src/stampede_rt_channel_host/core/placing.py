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


def together(groups_of: Mapping[bytes, Collection[bytes]]) -> list[list[bytes]]:
    """The channels in sets. Channels of one group are in the same set. `groups_of`: by channel, its groups."""
    bunch_of: dict[bytes, list[bytes]] = {}  # by channel
    of_group: dict[bytes, list[bytes]] = {}
    for channel_id, group_ids in groups_of.items():
        bunch = bunch_of[channel_id] = [channel_id]
        for group_id in group_ids:
            other = of_group.setdefault(group_id, bunch)
            if other is not bunch:
                for each in bunch:
                    bunch_of[each] = other
                other.extend(bunch)
                of_group.update((one, other) for one, held in of_group.items() if held is bunch)
                bunch = other
    return [*{id(bunch): bunch for bunch in bunch_of.values()}.values()]


def spread(bunches: Sequence[Sequence[bytes]], hosts: Sequence[OtherHost]) -> dict[bytes, OtherHost]:
    """A host for each channel. Each set goes to the least busy host; of equally busy hosts, to the one with the fewest
    channels.
    """
    assigned = dict.fromkeys((host.host_id for host in hosts), 0)
    found: dict[bytes, OtherHost] = {}
    for bunch in sorted(bunches, key=len, reverse=True):
        least = min(
            hosts,
            key=lambda host: (host.busy_permille // BUSY_STEP_PERMILLE, host.channels + assigned[host.host_id]),
        )
        assigned[least.host_id] += len(bunch)
        found |= dict.fromkeys(bunch, least)
    return found
