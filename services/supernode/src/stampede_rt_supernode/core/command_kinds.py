"""One row of the command table: the state machine's knowledge of one kind of command. Pure.

Each family of commands exports its rows as `KINDS` in its `kinds.py`. `command_table` joins them. The row in `codecs`
with the same operation defines the command's form in the log.
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
    """Accepts every operation, because supernodes make the operations of such a kind themselves."""


def _never_late(state: DirectoryState, operation: Operation, as_of_index: int) -> None:
    """Accepts every operation, because an operation of such a kind has the same effect at any time."""


@dataclass(frozen=True, kw_only=True, slots=True)
class CommandKind(Generic[Op, Done]):
    """One kind of command: its subject, the reasons to refuse it, and its effect."""

    operation: type[Op]
    result: type[Done]
    # The level that the cluster must have before it may use the command; see `cluster.feature_levels`.
    feature_level: int
    # The id or name of the thing that the operation concerns. A request with the operation id of an earlier request
    # must have the same subject.
    subject: Callable[[Op], str]
    # The checks that need no state. A command that passes fits in a log entry. Raises InvalidName or InvalidArgument.
    check: Callable[[Op], None] = _check_nothing
    # Checks a command that was made when the log had reached `as_of_index` (0: unknown). Raises Unavailable with reason
    # AMBIGUOUS if it comes too late.
    check_not_late: Callable[[DirectoryState, Op, int], None] = _never_late
    # Performs the command. Gets the state, the operation, and the command's time in Unix nanoseconds. Either raises a
    # StampedeError and changes nothing, or succeeds.
    apply: Callable[[DirectoryState, Op, int], Done]
    # Whether the directory refuses the command while the memory for answers is full. False for the supernodes' own
    # commands, which are few.
    needs_room: bool = True
    # Whether the directory remembers the answer, so that it performs the command only once for each operation id.
    is_remembered: bool = True


def on_tables(transition: Callable[[Tables, Op], Done]) -> Callable[[DirectoryState, Op, int], Done]:
    """The `apply` of a command that concerns only the tables."""

    def apply(state: DirectoryState, operation: Op, time_unix_nano: int) -> Done:
        return transition(state.tables, operation)

    return apply


def on_tables_with_creator(transition: Callable[[Tables, Made], Done]) -> Callable[[DirectoryState, Made, int], Done]:
    """Like `on_tables`, but for a command that may create a thing. Below OWNERS_LEVEL no replica keeps the creator."""

    def apply(state: DirectoryState, operation: Made, time_unix_nano: int) -> Done:
        if state.feature_level < OWNERS_LEVEL:
            operation = replace(operation, created_by="", created_max=None)
        return transition(state.tables, operation)

    return apply
