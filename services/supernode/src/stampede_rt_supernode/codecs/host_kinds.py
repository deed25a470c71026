"""Converts commands about hosts, and their results, from and to messages of the log."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.host_codec import (
    endpoint_message,
    endpoints_from,
    host_entry,
    host_from,
    load_from,
    load_message,
)
from stampede_rt_supernode.codecs.kind_codec import KindCodec
from stampede_rt_supernode.core.hosts.commands import (
    DeregisterHost,
    ExpireHost,
    HostDeregistered,
    HostExpired,
    HostLoadsNoted,
    HostRegistered,
    NoteHostLoads,
    RegisterHost,
    ReportedLoad,
)


def _register_message(operation: RegisterHost) -> pb.RegisterHostCommand:
    return pb.RegisterHostCommand(
        host_id=operation.host_id,
        name=operation.name,
        gatekeepers=[endpoint_message(endpoint) for endpoint in operation.gatekeepers],
        boot_incarnation=operation.boot_incarnation,
        version=operation.version,
        new_incarnation=operation.new_incarnation,
        registration_epoch=operation.registration_epoch,
        has_archive=operation.has_archive,
        continues_boot_incarnation=operation.continues_boot_incarnation,
        move_key=operation.move_key,
        private=operation.is_private,
        machine=operation.machine,
        archive_wait_nanos=operation.archive_wait_nanos,
        archive_place=operation.archive_place,
    )


def _read_register(message: pb.RegisterHostCommand) -> RegisterHost:
    return RegisterHost(
        host_id=message.host_id,
        name=message.name,
        gatekeepers=endpoints_from(message.gatekeepers),
        boot_incarnation=message.boot_incarnation,
        version=message.version,
        new_incarnation=message.new_incarnation,
        registration_epoch=message.registration_epoch,
        has_archive=message.has_archive,
        continues_boot_incarnation=message.continues_boot_incarnation,
        move_key=message.move_key,
        is_private=message.private,
        machine=message.machine,
        archive_wait_nanos=message.archive_wait_nanos,
        archive_place=message.archive_place,
    )


def _deregister_message(operation: DeregisterHost) -> pb.DeregisterHostCommand:
    return pb.DeregisterHostCommand(host_id=operation.host_id, boot_incarnation=operation.boot_incarnation)


def _read_deregister(message: pb.DeregisterHostCommand) -> DeregisterHost:
    return DeregisterHost(host_id=message.host_id, boot_incarnation=message.boot_incarnation)


def _expire_message(operation: ExpireHost) -> pb.ExpireHostCommand:
    return pb.ExpireHostCommand(
        host_id=operation.host_id,
        boot_incarnation=operation.boot_incarnation,
        registered_index=operation.registered_index,
        tenure=operation.tenure,
    )


def _read_expire(message: pb.ExpireHostCommand) -> ExpireHost:
    return ExpireHost(
        host_id=message.host_id,
        boot_incarnation=message.boot_incarnation,
        registered_index=message.registered_index,
        tenure=message.tenure,
    )


def _loads_message(operation: NoteHostLoads) -> pb.NoteHostLoadsCommand:
    loads = [
        pb.ReportedHostLoad(host_id=one.host_id, registered_index=one.registered_index, load=load_message(one.load))
        for one in operation.loads
    ]
    return pb.NoteHostLoadsCommand(tenure=operation.tenure, loads=loads)


def _read_loads(message: pb.NoteHostLoadsCommand) -> NoteHostLoads:
    loads = (
        ReportedLoad(host_id=one.host_id, registered_index=one.registered_index, load=load_from(one.load))
        for one in message.loads
    )
    return NoteHostLoads(tenure=message.tenure, loads=tuple(loads))


def _registered_message(result: HostRegistered) -> pb.HostRegisteredResult:
    return pb.HostRegisteredResult(host=host_entry(result.host), cluster_id=result.cluster_id)


def _read_registered(message: pb.HostRegisteredResult) -> HostRegistered:
    return HostRegistered(host=host_from(message.host), cluster_id=message.cluster_id)


CODECS: tuple[KindCodec[Any, Any, Any, Any], ...] = (
    KindCodec(
        kind="register_host",
        outcome="host_registered",
        operation=RegisterHost,
        result=HostRegistered,
        write=_register_message,
        read=_read_register,
        write_result=_registered_message,
        read_result=_read_registered,
    ),
    KindCodec(
        kind="deregister_host",
        outcome="host_deregistered",
        operation=DeregisterHost,
        result=HostDeregistered,
        write=_deregister_message,
        read=_read_deregister,
        write_result=lambda one: pb.HostDeregisteredResult(),
        read_result=lambda message: HostDeregistered(),
    ),
    KindCodec(
        kind="expire_host",
        outcome="host_expired",
        operation=ExpireHost,
        result=HostExpired,
        write=_expire_message,
        read=_read_expire,
        write_result=lambda one: pb.HostExpiredResult(expired=one.expired),
        read_result=lambda message: HostExpired(expired=message.expired),
    ),
    KindCodec(
        kind="note_host_loads",
        outcome="host_loads_noted",
        operation=NoteHostLoads,
        result=HostLoadsNoted,
        write=_loads_message,
        read=_read_loads,
        write_result=lambda one: pb.HostLoadsNotedResult(noted=one.noted),
        read_result=lambda message: HostLoadsNoted(noted=message.noted),
    ),
)
