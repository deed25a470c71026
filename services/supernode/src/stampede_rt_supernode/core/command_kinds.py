"""One row of the command table: what the state machine knows of one kind of command. Pure.

Each family of commands exports its rows as `KINDS` in its `kinds.py`; `command_table` joins them. The row in `codecs`
that has the same operation says how the command travels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from stampede_rt_supernode.core.cluster.feature_levels import OWNERS_LEVEL
from stampede_rt_supernode.core.commands import Creation, Operation, Success
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.tables import Tables

Op = TypeVar("Op", bound=Operation)
Made = TypeVar("Made", bound=Creation)
Done = TypeVar("Done", bound=Success)


def _check_nothing(operation: Operation) -> None:
    """The supernodes make it themselves, and make it well."""


def _never_late(state: DirectoryState, operation: Operation, as_of_index: int) -> None:
    """It does the same whenever it comes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CommandKind(Generic[Op, Done]):
    """One kind of command: its subject, the reasons to refuse it, and its effect."""

    operation: type[Op]
    result: type[Done]
    # The level that the cluster must have reached before the command may be used, see `cluster.feature_levels`.
    feature_level: int
    # The thing that it is about: a request id that comes back with another one is a mistake.
    subject: Callable[[Op], str]
    # What can be said without any state. A command that passes fits into a log entry. Raises InvalidName or
    # InvalidArgument.
    check: Callable[[Op], None] = _check_nothing
    # Whether a command that was made when the log had reached `as_of_index` (0: not told) may still be done. Raises
    # Unavailable with reason AMBIGUOUS.
    check_in_time: Callable[[DirectoryState, Op, int], None] = _never_late
    # Does it: (state, operation, the command's time in Unix nanoseconds). Raises a StampedeError and has changed
    # nothing, or is done.
    apply: Callable[[DirectoryState, Op, int], Done]
    # Whether it is refused while no more answers can be remembered. Not so for what supernodes make themselves: they
    # never make too many.
    needs_room: bool = True
    # Whether its answer is remembered, so that the same request id is done once.
    is_remembered: bool = True


def on_tables(transition: Callable[[Tables, Op], Done]) -> Callable[[DirectoryState, Op, int], Done]:
    """`apply` for a command that concerns the tables alone."""

    def apply(state: DirectoryState, operation: Op, time_unix_nano: int) -> Done:
        return transition(state.tables, operation)

    return apply


def noting_creator(transition: Callable[[Tables, Made], Done]) -> Callable[[DirectoryState, Made, int], Done]:
    """As `on_tables`, for a command that may make a thing. Below OWNERS_LEVEL no replica keeps who did."""

    def apply(state: DirectoryState, operation: Made, time_unix_nano: int) -> Done:
        if state.feature_level < OWNERS_LEVEL:
            operation = replace(operation, created_by="")
        return transition(state.tables, operation)

    return apply
