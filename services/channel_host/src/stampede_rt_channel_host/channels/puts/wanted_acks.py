"""The condition under which a put is acknowledged: immediately, on stable storage, or at replicas (`Ack`)."""

from __future__ import annotations

from functools import partial
from typing import Protocol

from stampede_rt.errors import InvalidArgument, NotReplicated
from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.puts.held_acks import (
    WAIT_NANOS_DEFAULT,
    AckOfDisk,
    AckOfReplicas,
    HeldAck,
    not_archived,
)
from stampede_rt_channel_host.channels.puts.read_ahead import left_nanos
from stampede_rt_channel_host.channels.replication import Replication, ReplicationKind

_KNOWN = frozenset(channel_pb2.Ack.values())


def check_wanted(hosted: HostedChannel, stated: int) -> None:
    """Raises InvalidArgument if the channel cannot acknowledge a put in the stated way."""
    if not stated and hosted.record.policy.ack != "disk":
        return
    name = hosted.record.name
    if stated not in _KNOWN:
        raise InvalidArgument(f"ack is {stated}, which this version does not know; see Ack for the values")
    if stated == channel_pb2.ACK_REPLICA and hosted.replication is None:
        raise InvalidArgument(
            f'a put states ack="replica", and channel {name} has no replicas; give it `replicas`, or leave ack out'
        )
    if _waits_for_disk(hosted, stated) and hosted.recording is None:
        raise InvalidArgument(
            f'a put states ack="disk", and channel {name} is not recorded; give it `archive`, or leave ack out'
        )


def check_disk(hosted: HostedChannel, stated: int, *, is_repeated: bool) -> None:
    """Raises NotArchived for a put that waits for the disk while the archive of its channel takes no items.

    It does not raise for a repeated put, because the channel has accepted its items: such a put waits for them again.
    """
    recording = hosted.recording
    if recording is not None and recording.recorder.failure and not is_repeated and _waits_for_disk(hosted, stated):
        raise not_archived(hosted.record.name, recording.recorder.failure)


class WantedAck(Protocol):
    """The acknowledgement that a put wants."""

    @property
    def ack(self) -> int:
        """A number of the enum Ack."""

    @property
    def wait_nanos(self) -> int | None:
        """The longest wait for the acknowledgement; None: without a limit."""


def held_ack(ack: pb.PutAck, hosted: HostedChannel, put: WantedAck, received_s: float) -> pb.PutAck | HeldAck:
    """The ack, or a `HeldAck` that waits for stable storage or for replicas.

    `received_s`: when the put came, monotonic.
    """
    if not ack.HasField("first_seq"):
        return ack
    name, recording, replication = hosted.record.name, hosted.recording, hosted.replication
    if recording is not None and _waits_for_disk(hosted, put.ack):
        return AckOfDisk(ack, name, recording, _left_nanos(put, received_s))
    if replication is None:
        return ack
    waits = put.ack == channel_pb2.ACK_REPLICA or (not put.ack and replication.kind is ReplicationKind.WAITED_FOR)
    if not waits and (replication.kind is ReplicationKind.WAITED_FOR or replication.is_within_lag):
        return ack
    explain, is_enough = (
        partial(_not_replicated, name, replication),
        None if waits else lambda: replication.is_within_lag,
    )
    return AckOfReplicas(ack, replication, hosted.core.next_seq, _left_nanos(put, received_s), explain, is_enough)


def _not_replicated(channel: str, replication: Replication, ack: pb.PutAck) -> NotReplicated:
    return NotReplicated(
        f"channel {channel} has accepted the put, but the replicas did not have it in time: the put is at "
        f"{ack.copies - 1} replicas in sync, and min_replicas is {replication.min_replicas}; readers see the put when "
        f"it is replicated; look at `stampede info {channel}`, or start another host",
        metadata={"channel": channel, "seq": str(ack.first_seq), "copies": str(ack.copies)},
    )


def _waits_for_disk(hosted: HostedChannel, stated: int) -> bool:
    return stated == channel_pb2.ACK_DISK or (not stated and hosted.record.policy.ack == "disk")


def _left_nanos(put: WantedAck, received_s: float) -> int | None:
    wait_nanos = put.wait_nanos
    if wait_nanos is None:
        return None
    return left_nanos(wait_nanos if wait_nanos > 0 else WAIT_NANOS_DEFAULT, received_s)
