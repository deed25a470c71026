"""Operations on the directory, and their results. Pure, immutable values.

The proposer puts all random values and clock readings into the command, so that every replica computes the same result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

from stampede_rt.errors import StampedeError, error_for


class Operation:
    """Base of all operations on the directory. Each one has a row in `command_table`."""

    __slots__ = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Creation(Operation):
    """Base of the operations that may create a channel, queue, group or peer.

    `created_by`: the caller, see ChannelRecord. `created_max`: how many things of this kind the caller may have; None
    if there is no limit.
    """

    created_by: str = ""
    created_max: int | None = None


class Success:
    """Base of the results of operations that were done."""

    __slots__ = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """One entry of the log. A command with the `op_id` of a remembered command only repeats that command's result.

    `time_unix_nano`: the time of the supernode that proposes the command. `as_of_index`: the log position of that
    supernode's state when it received the request; 0 if it is unknown. `caller`: the name of the caller; empty if the
    caller has no name of its own.
    """

    op_id: bytes
    time_unix_nano: int
    operation: Operation
    as_of_index: int = 0
    caller: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class RefusedOperation:
    """The result of a refused operation, which changed nothing.

    The fields have the values of the StampedeError that refused it.
    """

    reason: str
    message: str
    metadata: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def because(cls, error: StampedeError) -> RefusedOperation:
        """The refusal for `error`."""
        return cls(reason=error.reason, message=error.message, metadata=MappingProxyType(error.metadata))

    def error(self) -> StampedeError:
        """The error to raise to the caller."""
        return error_for(self.reason, self.message, self.metadata)


Result: TypeAlias = RefusedOperation | Success
