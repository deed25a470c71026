"""Operations on the directory, and their results. Pure, immutable values.

All that is random or read from a clock is stamped into a command by its proposer, so that every replica computes the
same from it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

from stampede_rt.errors import StampedeError, error_for


class Operation:
    """Base of all that can be done to the directory. Each one has a row in `command_table`."""

    __slots__ = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Creation(Operation):
    """Base of what may make a channel, queue or group. `created_by`: its caller, see ChannelRecord."""

    created_by: str = ""


class Success:
    """Base of all that comes of an operation that was done."""

    __slots__ = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """One entry of the log. Repeating `op_id` repeats the result; `time_unix_nano` is for whoever reads the log.

    `as_of_index`: how far the proposer's state reached when the request came; 0: not told.
    """

    op_id: bytes
    time_unix_nano: int
    operation: Operation
    as_of_index: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class Refused:
    """Nothing was changed, and why: the particulars of a StampedeError."""

    reason: str
    message: str
    metadata: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def because(cls, error: StampedeError) -> Refused:
        """The refusal that `error` stands for."""
        return cls(reason=error.reason, message=error.message, metadata=MappingProxyType(error.metadata))

    def error(self) -> StampedeError:
        """The exception to raise to the caller."""
        return error_for(self.reason, self.message, self.metadata)


Result: TypeAlias = Refused | Success
