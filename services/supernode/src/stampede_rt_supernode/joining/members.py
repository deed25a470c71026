"""The supernodes as this supernode sees them: the members of the log, and their states."""

from __future__ import annotations

import secrets
from collections.abc import Mapping

from stampede_rt.v1 import directory_pb2
from stampede_rt_supernode.joining.probe import Probe
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import Member, ReplicatedLog, ReplicationStatus


def why_diverged(status: ReplicationStatus) -> str:
    """The reason why this supernode does not serve, as one sentence."""
    return (
        f"the state of {status.self_id!r} differs from that of most members at log position {status.diverged_at}, for "
        "example because a release did not know all commands, or memory was damaged"
    )


def why_in_doubt(member_id: str, log_index: int) -> str:
    """The reason why a member's state is in doubt, as one sentence."""
    return (
        f"the state of {member_id!r} differs from that of the leader at log position {log_index}, and neither is known "
        "to be that of most members, so it is unknown which of them is right"
    )


def why_waits_for_disk(status: ReplicationStatus) -> str:
    """The reason why this supernode waits for its disk, as one sentence."""
    return (
        f"{status.self_id!r} accepts no changes and no reads, because the disk of its data folder has not answered for "
        f"{status.disk_silent_seconds:.0f} s"
    )


class Members:
    """The members and their states, as this supernode knows them. No method waits.

    `advertise`: the address at which callers reach this supernode. `zone`: the zone of this supernode.
    """

    def __init__(
        self, log: ReplicatedLog, replica: DirectoryReplica, probe: Probe, *, advertise: str, zone: str
    ) -> None:
        self._log = log
        self._replica = replica
        self._probe = probe
        self._advertise = advertise
        self._zone = zone
        # A random number of this start of the process.
        self.boot_incarnation = secrets.randbits(63) | 1

    @property
    def self_id(self) -> str:
        """This supernode's id."""
        return self._log.status().self_id

    def ready(self) -> bool:
        """Whether this supernode can serve: it knows a leader, its state is sound, and the cluster is founded."""
        founded = self._replica.read(lambda directory: directory.tenure > 0)
        status = self._log.status()
        return founded and status.leader_id is not None and not status.diverged_at

    def refused(self) -> Mapping[str, str]:
        """By id: the trouble of each member in trouble, and the member that reports it.

        These are members whose stores this supernode refuses, or whose states are in doubt. This supernode itself is
        among them if others refuse it, its state differs, or its disk does not answer.
        """
        status = self._log.status()
        refusals = {name: f"{why} (says {status.self_id})" for name, why in status.refused_members.items()}
        by = "; ".join(f"{why} (says {name})" for name, why in sorted(status.refusing_members.items()))
        own = why_waits_for_disk(status) if status.disk_silent_seconds else by
        own = why_diverged(status) if status.diverged_at else own
        doubts = {name: why_in_doubt(name, at) for name, at in status.doubts.items()}
        return {**doubts, **refusals, **({status.self_id: own} if own else {})}

    def records(self) -> tuple[list[directory_pb2.SupernodeRecord], int]:
        """Every member, by id, and the present term."""
        status = self._log.status()
        members = sorted(status.members, key=lambda member: member.member_id)
        return [self._record(member, status) for member in members], status.term

    def _record(self, member: Member, status: ReplicationStatus) -> directory_pb2.SupernodeRecord:
        is_self = member.member_id == status.self_id
        finding = self._probe.finding(member.member_id)
        endpoint = directory_pb2.Endpoint(
            target=self._advertise if is_self else member.address, zone=self._zone if is_self else ""
        )
        return directory_pb2.SupernodeRecord(
            supernode_id=member.member_id,
            endpoint=endpoint,
            is_leader=member.member_id == status.leader_id,
            healthy=self.ready() if is_self else finding is not None and finding.healthy,
            round_trip_nanos=finding.round_trip_nanos if finding is not None else None,
            highest_feature_level=status.highest_levels.get(member.member_id, 0),
        )
