"""Chooses hosts for channels, queues and copies by the hosts' loads (decision 0162). Pure.

Each host reports its load with its lease, and the leader notes the loads in the log when they have changed. So every
replica makes the same choice. Until the next report the choice assumes a load for each thing that the host has got
since. So requests that come between two reports do not all go to the same host.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from itertools import islice

from stampede_rt.errors import Overloaded
from stampede_rt_supernode.core.records import HostLoad, HostRecord
from stampede_rt_supernode.core.tables import Tables

CHANNELS_PER_HOST_MAX = 100_000
THING_PERMILLE = 20
"""The load that the choice assumes for a new channel or queue: a channel of video takes about 2 % of a core."""
STEP_PERMILLE = 100
"""Loads within the same tenth count as equal. Then the numbers of channels decide."""
FULL_PERMILLE = 950
"""A host with this load, or with this share of its memory in use, is chosen only if all hosts are so full."""
GROUPS_LOOKED_AT_MAX, MEMBERS_LOOKED_AT_MAX = 8, 64
SHARE_FACTOR, SHARE_FREE = 4, 64
"""Hosts report their own loads, and a report may be wrong. A host gets channels and queues for its low load only while
it owns at most SHARE_FREE things more than SHARE_FACTOR times the average of the other hosts.
"""


def least_loaded(tables: Tables, hosts: Iterable[HostRecord], count: Callable[[HostRecord], int]) -> HostRecord | None:
    """The host of `hosts` with the lowest load; None if there is none.

    Three kinds of hosts come after the others, in this order: hosts that own far more than the others (SHARE_FACTOR),
    hosts with a load of FULL_PERMILLE or more, and full hosts (`is_full`). Among hosts with about the same load it
    is the host with the lowest `count`, and among these the first host. If no load is known, only `count` decides: no
    load is known while the feature level is below LOADS_LEVEL. Private hosts are left out.
    """
    candidates = [host for host in hosts if not is_private(host)]
    if all(host.load is None for host in candidates):
        return min(candidates, key=count, default=None)
    owned = sum(_owned(tables, host) for host in candidates)

    def rank(host: HostRecord) -> tuple[bool, bool, bool, int, int]:
        load = load_permille(tables, host)
        far_more = _owns_far_more(_owned(tables, host), owned, len(candidates))
        return is_full(tables, host), load >= FULL_PERMILLE, far_more, load // STEP_PERMILLE, count(host)

    return min(candidates, key=rank)


def is_private(host: HostRecord) -> bool:
    """Whether only callers that name the host place something there."""
    return host.load is not None and host.load.is_private


def machine_of(host: HostRecord) -> str:
    """The machine of a host; empty if it is not known."""
    return "" if host.load is None else host.load.machine


def load_permille(tables: Tables, host: HostRecord) -> int:
    """The estimated load in thousandths: of a core, or of the memory, whichever is more.

    A host without a report counts with an assumed load for each thing that it owns.
    """
    load = host.load or HostLoad()
    new = max(0, _owned(tables, host) - load.owned)
    return max(load.busy_permille + new * THING_PERMILLE, _memory_permille(host))


def _owned(tables: Tables, host: HostRecord) -> int:
    return host.channels + tables.queues.count_at(host.host_id)


def _owns_far_more(owned: int, owned_by_all: int, hosts: int) -> bool:
    """Whether a host owns far more than its share: `owned` of the `owned_by_all` things that `hosts` hosts own."""
    return hosts > 1 and (owned - SHARE_FREE) * (hosts - 1) > SHARE_FACTOR * (owned_by_all - owned)


def _memory_permille(host: HostRecord) -> int:
    load = host.load
    return 0 if load is None or not load.bytes_max else load.held_bytes * 1000 // load.bytes_max


def is_full(tables: Tables, host: HostRecord) -> bool:
    """Whether new channels and queues should go to another host. Never True if the load is not known."""
    return has_all_channels(host) or _memory_permille(host) >= FULL_PERMILLE


def has_all_channels(host: HostRecord) -> bool:
    """Whether the host owns as many channels as a host can.

    Does not check hosts without a known load: while the feature level is below LOADS_LEVEL, supernodes of earlier
    releases do not check either.
    """
    return host.load is not None and host.channels >= CHANNELS_PER_HOST_MAX


def check_has_place(host: HostRecord, channel: str) -> None:
    """Raises Overloaded if the host cannot own another channel."""
    if has_all_channels(host):
        raise Overloaded(
            f"channel {channel} gets no host: host {host.name} owns {host.channels} channels, and a host owns at most "
            f"{CHANNELS_PER_HOST_MAX}; delete some, or start another host with `stampede host`",
            metadata={"channel": channel, "host": host.name},
        )


def beside_its_group(tables: Tables, channel_id: bytes) -> HostRecord | None:
    """The live host that owns most of the other members of the channel's groups.

    If the new channel is at this host, the hosts of the group exchange fewer times. Returns None if there is no such
    host, or if its load leaves no room. Looks at a bounded number of groups and members.
    """
    owned: Counter[bytes] = Counter()
    for group in islice(tables.groups.with_channel(channel_id), GROUPS_LOOKED_AT_MAX):
        for member in islice(group.spec.channel_ids, MEMBERS_LOOKED_AT_MAX):
            if member != channel_id:
                owned[tables.channels[member].host_id] += 1
    near = [tables.hosts[one] for one in owned]
    fitting = [host for host in near if host.alive and not is_private(host) and _has_room(tables, host)]
    return min(fitting, key=lambda host: (-owned[host.host_id], host.name), default=None)


def has_room_by_report(tables: Tables, host: HostRecord) -> bool:
    """Whether the host had room at its last report. Things that it got since do not count yet."""
    return not is_full(tables, host) and (host.load is None or host.load.busy_permille < FULL_PERMILLE)


def _has_room(tables: Tables, host: HostRecord) -> bool:
    return host.load is not None and not is_full(tables, host) and load_permille(tables, host) < FULL_PERMILLE
