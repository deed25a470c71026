"""The rows of hosts in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.cluster.feature_levels import LOADS_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.hosts.commands import (
    DeregisterHost,
    ExpireHost,
    HostDeregistered,
    HostExpired,
    HostLoadsNoted,
    HostRegistered,
    NoteHostLoads,
    RegisterHost,
)
from stampede_rt_supernode.core.hosts.transitions import (
    check_register,
    deregister_host,
    expire_host,
    note_host_loads,
    register_host,
)
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.validation import check_id


def _register(state: DirectoryState, operation: RegisterHost, time_unix_nano: int) -> HostRegistered:
    state.check_founded()
    host = register_host(state.tables, operation, has_level_4=state.feature_level >= LOADS_LEVEL)
    return HostRegistered(host=host, cluster_id=state.cluster_id)


def _deregister(state: DirectoryState, operation: DeregisterHost, time_unix_nano: int) -> HostDeregistered:
    deregister_host(state.tables, operation)
    return HostDeregistered()


def _expire(state: DirectoryState, operation: ExpireHost, time_unix_nano: int) -> HostExpired:
    return HostExpired(expired=expire_host(state.tables, operation, state.tenure, time_unix_nano))


def _note_loads(state: DirectoryState, operation: NoteHostLoads, time_unix_nano: int) -> HostLoadsNoted:
    return HostLoadsNoted(noted=note_host_loads(state.tables, operation, state.tenure))


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=RegisterHost,
        result=HostRegistered,
        feature_level=1,
        subject=lambda one: one.host_id.hex(),
        check=check_register,
        apply=_register,
    ),
    CommandKind(
        operation=DeregisterHost,
        result=HostDeregistered,
        feature_level=1,
        subject=lambda one: one.host_id.hex(),
        check=lambda one: check_id(one.host_id, "host_id"),
        apply=_deregister,
    ),
    CommandKind(
        operation=ExpireHost,
        result=HostExpired,
        feature_level=1,
        subject=lambda one: one.host_id.hex(),
        apply=_expire,
        needs_room=False,
    ),
    CommandKind(
        operation=NoteHostLoads,
        result=HostLoadsNoted,
        feature_level=LOADS_LEVEL,
        subject=lambda one: str(one.tenure),
        apply=_note_loads,
        is_remembered=False,  # a repeated command sets the same loads
    ),
)
