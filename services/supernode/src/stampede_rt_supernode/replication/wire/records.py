"""Encodes and decodes entries, configurations and snapshots, for the wire and the store.

Decoding checks every number, size and kind.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from google.protobuf.message import DecodeError

from stampede_rt.v1 import raft_service_pb2 as pb
from stampede_rt_supernode.replication.configuration import MEMBERS_MAX, RETIRED_MAX, Configuration
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.log_entries import COMMAND, CONFIGURATION, NO_OP, Entry
from stampede_rt_supernode.replication.settings import COMMAND_BYTES_MAX

# Half of the greatest number that the disk format allows, so that numbers counted up from here stay within it.
INT_MAX = 2**62
MEMBER_ID_BYTES_MAX, ADDRESS_BYTES_MAX = 512, 512


class MalformedMessage(ValueError):
    """A member sent bytes that no member of this version sends."""


def checked_number(value: int) -> int:
    """Return `value`. Raises MalformedMessage if it is more than INT_MAX."""
    if value > INT_MAX:
        raise MalformedMessage(f"{value} is past 2^62")
    return value


def check_command(command: bytes) -> bytes:
    """Check a log command (kind byte and payload) and return it. Raises MalformedMessage."""
    if not command or command[0] not in (COMMAND, NO_OP, CONFIGURATION):
        raise MalformedMessage("a log entry is of no known kind")
    if command[0] == CONFIGURATION:
        decode_configuration(command)
    if len(command) > COMMAND_BYTES_MAX + 1:
        raise MalformedMessage(f"a command of {len(command) - 1} bytes is over the limit of {COMMAND_BYTES_MAX}")
    return command


def encode_members(members: Iterable[Member]) -> list[pb.RaftMember]:
    """The protobuf form of members."""
    return [pb.RaftMember(member_id=member.member_id, address=member.address) for member in members]


def decode_members(members: Iterable[pb.RaftMember]) -> list[Member]:
    """The members, checked. Raises MalformedMessage."""
    found = [Member(member_id=member.member_id, address=member.address) for member in members]
    if len({member.member_id for member in found}) != len(found) or len(found) > MEMBERS_MAX:
        raise MalformedMessage(f"{len(found)} members are too many, or one is named twice")
    if not all(0 < len(member.member_id.encode()) <= MEMBER_ID_BYTES_MAX for member in found):
        raise MalformedMessage("a member has no id, or one that is too long")
    if not all(0 < len(member.address.encode()) <= ADDRESS_BYTES_MAX for member in found):
        raise MalformedMessage("a member has no address, or one that is too long")
    return found


def encode_configuration(configuration: Configuration) -> bytes:
    """The log command that puts a configuration into effect."""
    return bytes((CONFIGURATION,)) + _configuration_message(configuration).SerializeToString(deterministic=True)


def decode_configuration(command: bytes) -> Configuration:
    """The configuration in a log command of kind CONFIGURATION. Raises MalformedMessage if it cannot be read."""
    try:
        message = pb.RaftConfiguration.FromString(command[1:])
    except DecodeError as error:
        raise MalformedMessage(f"a configuration cannot be read: {error}") from error
    return _configuration(message)


def _configuration_message(configuration: Configuration) -> pb.RaftConfiguration:
    return pb.RaftConfiguration(
        members=encode_members(configuration.members),
        retired_ids=configuration.retired,
        spent_tickets=[
            pb.RaftSpentTicket(ticket_sha256=ticket, member_id=member_id) for ticket, member_id in configuration.spent
        ],
    )


def _configuration(message: pb.RaftConfiguration) -> Configuration:
    if not message.members or len(message.retired_ids) > RETIRED_MAX:
        raise MalformedMessage("a configuration names no member, or too many former members")
    members = decode_members(message.members)
    if not {member.member_id for member in members}.isdisjoint(message.retired_ids):
        raise MalformedMessage("a configuration names a member that was removed")
    spent = [(one.ticket_sha256, one.member_id) for one in message.spent_tickets]
    return Configuration.of(members, message.retired_ids, spent)


def encode_entry(entry: Entry) -> pb.RaftLogEntry:
    """The protobuf form of an entry, on the wire and in snapshots."""
    return pb.RaftLogEntry(log_index=entry[1], term=entry[2], command=entry[0])


def decode_entry(entry: pb.RaftLogEntry) -> Entry:
    """The entry, checked. Raises MalformedMessage."""
    if entry.log_index == 0:
        raise MalformedMessage("log positions start at 1")
    return Entry(check_command(entry.command), checked_number(entry.log_index), checked_number(entry.term))


@dataclass(frozen=True, kw_only=True, slots=True)
class SnapshotContents:
    """The parts of a snapshot: the last two entries that it covers, the members, and the encoded state.

    `configuration` is None if the snapshot is of an early release, which could not change the members.
    """

    previous: Entry
    last: Entry
    configuration: Configuration | None
    state: bytes


def encode_snapshot(*, previous: Entry, last: Entry, configuration: Configuration, state: bytes) -> bytes:
    """An encoded snapshot, for the store and the wire."""
    return pb.RaftSnapshot(
        previous=encode_entry(previous),
        last=encode_entry(last),
        member_ids=[member.member_id for member in configuration.members],
        configuration=_configuration_message(configuration),
        state=state,
    ).SerializeToString(deterministic=True)


def decode_snapshot(record: bytes) -> SnapshotContents:
    """The checked parts of an encoded snapshot. Raises MalformedMessage."""
    try:
        snapshot = pb.RaftSnapshot.FromString(record)
    except DecodeError as error:
        raise MalformedMessage(f"a snapshot cannot be read: {error}") from error
    previous, last = decode_entry(snapshot.previous), decode_entry(snapshot.last)
    if last.log_index != previous.log_index + 1 or last.term < previous.term:
        raise MalformedMessage("a snapshot's last two entries are not neighbours")
    configuration = _configuration(snapshot.configuration) if snapshot.HasField("configuration") else None
    return SnapshotContents(previous=previous, last=last, configuration=configuration, state=snapshot.state)
