"""Keeps the loads of owners and copies that hosts report, while this supernode leads, and returns them to callers.

A thin shell around `core.replicas.loads`.
"""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.errors import HostNotFound, InvalidArgument, LeaseExpired
from stampede_rt_runtime.clock import HostClock
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.hosts.transitions import check_boot
from stampede_rt_supernode.core.lookups import host_by_id
from stampede_rt_supernode.core.replicas.loads import REPORT_LOADS_MAX, ReplicaLoad, ReplicaLoads
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReplicatedLog
from stampede_rt_supernode.servicers.lease_keeper import not_leader


class LoadKeeper:
    """The loads that hosts report. Use it on one event loop. No method waits."""

    def __init__(self, log: ReplicatedLog, replica: DirectoryReplica, *, clock: HostClock) -> None:
        self._log = log
        self._replica = replica
        self._clock = clock
        self._loads = ReplicaLoads()

    def report(self, host_id: bytes, boot_incarnation: int, loads: Sequence[ReplicaLoad]) -> list[bytes]:
        """Note the loads that a host reports. Raises InvalidArgument, NotLeader or LeaseExpired.

        Returns the reported channels that the host neither owns nor holds a copy of, because they were taken away.
        """
        if len(loads) > REPORT_LOADS_MAX:
            raise InvalidArgument(f"the report has {len(loads)} loads; {REPORT_LOADS_MAX} at most; send two reports")
        for load in loads:
            if load.host_id != host_id:
                raise InvalidArgument(f"host {host_id.hex()} reports a load of host {load.host_id.hex()}; leave it out")
        status = self._log.status()
        if not status.is_leader:
            raise not_leader(status)
        self._loads.lead(status.tenure)
        held = self._replica.read(lambda directory: _held(directory, host_id, boot_incarnation, loads))
        self._loads.note(held, self._clock.boottime_nanos())
        known = {load.channel_id for load in held}
        return [load.channel_id for load in loads if load.channel_id not in known]

    def of(self, channel_id: bytes, host_ids: Sequence[bytes]) -> list[ReplicaLoad]:
        """The loads that these hosts reported for a channel, the least loaded first.

        Empty if this supernode does not lead.
        """
        self._loads.lead(self._log.status().tenure)
        return self._loads.of(channel_id, host_ids, self._clock.boottime_nanos())


def _held(directory: Directory, host_id: bytes, boot: int, loads: Sequence[ReplicaLoad]) -> list[ReplicaLoad]:
    try:
        host = host_by_id(directory.tables, host_id)
    except HostNotFound as error:
        raise LeaseExpired(error.message, metadata=error.metadata) from error
    check_boot(host, boot)
    if not host.alive:
        text = f"host {host.name} has no lease; it ended, or the host left; register it again"
        raise LeaseExpired(text, metadata={"host": host.name})
    return [load for load in loads if _holds(directory.tables, host_id, load.channel_id)]


def _holds(tables: Tables, host_id: bytes, channel_id: bytes) -> bool:
    channel = tables.channels.get(channel_id)
    return channel is not None and (channel.host_id == host_id or host_id in channel.proxy_host_ids)
