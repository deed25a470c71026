"""The rows of hosts in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.hosts.commands import (
    DeregisterHost,
    ExpireHost,
    HostDeregistered,
    HostExpired,
    HostRegistered,
    RegisterHost,
)
from stampede_rt_supernode.core.hosts.transitions import check_register, deregister_host, expire_host, register_host
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.validation import check_id


def _register(state: DirectoryState, operation: RegisterHost, time_unix_nano: int) -> HostRegistered:
    state.check_founded()
    return HostRegistered(host=register_host(state.tables, operation), cluster_id=state.cluster_id)


def _deregister(state: DirectoryState, operation: DeregisterHost, time_unix_nano: int) -> HostDeregistered:
    deregister_host(state.tables, operation)
    return HostDeregistered()


def _expire(state: DirectoryState, operation: ExpireHost, time_unix_nano: int) -> HostExpired:
    return HostExpired(expired=expire_host(state.tables, operation, state.tenure, time_unix_nano))


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
)
