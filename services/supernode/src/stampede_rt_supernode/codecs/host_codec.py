"""Converts hosts from and to their messages. Makes no decisions."""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.v1 import directory_command_pb2, directory_pb2
from stampede_rt_supernode.core.records import Endpoint, HostLoad, HostRecord


def endpoints_from(endpoints: Iterable[directory_pb2.Endpoint]) -> tuple[Endpoint, ...]:
    """The endpoints of a repeated field."""
    return tuple(Endpoint(target=one.target, zone=one.zone) for one in endpoints)


def endpoint_message(endpoint: Endpoint) -> directory_pb2.Endpoint:
    """The message of an endpoint."""
    return directory_pb2.Endpoint(target=endpoint.target, zone=endpoint.zone)


def host_record(host: HostRecord) -> directory_pb2.HostRecord:
    """The record that clients get."""
    return directory_pb2.HostRecord(
        host_id=host.host_id,
        name=host.name,
        gatekeepers=[endpoint_message(endpoint) for endpoint in host.gatekeepers],
        boot_incarnation=host.boot_incarnation,
        alive=host.alive,
        channels=host.channels,
        version=host.version,
        lease_ended_unix_nano=host.lease_ended_unix_nano,
        registration_epoch=host.registration_epoch,
        load=None if host.load is None else load_message(host.load),
        archive_place=host.archive_place,
    )


def load_message(load: HostLoad) -> directory_pb2.HostLoad:
    """The message of a load."""
    return directory_pb2.HostLoad(
        busy_permille=load.busy_permille,
        held_bytes=load.held_bytes,
        bytes_max=load.bytes_max,
        owned=load.owned,
        has_archive=load.has_archive,
        private=load.is_private,
        machine=load.machine,
    )


def load_from(message: directory_pb2.HostLoad) -> HostLoad:
    """The load in a message."""
    return HostLoad(
        busy_permille=message.busy_permille,
        held_bytes=message.held_bytes,
        bytes_max=message.bytes_max,
        owned=message.owned,
        has_archive=message.has_archive,
        is_private=message.private,
        machine=message.machine,
    )


def host_entry(host: HostRecord) -> directory_command_pb2.HostEntry:
    """The entry that supernodes keep for a host."""
    return directory_command_pb2.HostEntry(
        record=host_record(host),
        registered_index=host.registered_index,
        move_key=host.move_key,
        archive_wait_nanos=host.archive_wait_nanos,
    )


def host_from(entry: directory_command_pb2.HostEntry) -> HostRecord:
    """The host of an entry that this codec wrote."""
    record = entry.record
    return HostRecord(
        host_id=record.host_id,
        name=record.name,
        gatekeepers=endpoints_from(record.gatekeepers),
        boot_incarnation=record.boot_incarnation,
        version=record.version,
        alive=record.alive,
        channels=record.channels,
        registered_index=entry.registered_index,
        lease_ended_unix_nano=record.lease_ended_unix_nano if record.HasField("lease_ended_unix_nano") else None,
        registration_epoch=record.registration_epoch,
        load=load_from(record.load) if record.HasField("load") else None,
        move_key=entry.move_key,
        archive_wait_nanos=entry.archive_wait_nanos,
        archive_place=record.archive_place,
    )
