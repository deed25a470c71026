"""The table of all kinds of commands, joined from their families. Pure.

A new command needs four things: its operation and result in the family's `commands.py`, its row in the family's
`kinds.py`, its row in `codecs`, and its member in directory_command.proto. A test finds a command that lacks one of
them.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from stampede_rt_supernode.core.access import kinds as access_kinds
from stampede_rt_supernode.core.channels import kinds as channel_kinds
from stampede_rt_supernode.core.cluster import kinds as cluster_kinds
from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.commands import Operation
from stampede_rt_supernode.core.groups import kinds as group_kinds
from stampede_rt_supernode.core.hosts import kinds as host_kinds
from stampede_rt_supernode.core.moves import kinds as move_kinds
from stampede_rt_supernode.core.peers import kinds as peer_kinds
from stampede_rt_supernode.core.queues import kinds as queue_kinds
from stampede_rt_supernode.core.replicas import kinds as replica_kinds

KINDS: tuple[CommandKind[Any, Any], ...] = (
    *access_kinds.KINDS,
    *channel_kinds.KINDS,
    *cluster_kinds.KINDS,
    *group_kinds.KINDS,
    *host_kinds.KINDS,
    *move_kinds.KINDS,
    *peer_kinds.KINDS,
    *queue_kinds.KINDS,
    *replica_kinds.KINDS,
)
_BY_OPERATION: Mapping[type[Operation], CommandKind[Any, Any]] = MappingProxyType({one.operation: one for one in KINDS})
FEATURE_LEVELS: Mapping[type[Operation], int] = MappingProxyType({one.operation: one.feature_level for one in KINDS})


def kind_of(operation: Operation) -> CommandKind[Any, Any]:
    """The row of an operation."""
    return _BY_OPERATION[type(operation)]


def subject_of(operation: Operation) -> str:
    """The subject of an operation: its class name, and the id or name of the object that it concerns."""
    return f"{type(operation).__name__} {kind_of(operation).subject(operation)}"


def check_operation(operation: Operation) -> None:
    """Check `operation` without any state, so that invalid operations never come into the log.

    An operation that passes fits in a log entry. Raises InvalidName or InvalidArgument.
    """
    kind_of(operation).check(operation)
