"""One row of the command codec: how one kind of command and its result travel in the log. Decides nothing.

Each family of commands exports its rows as `CODECS`; `command_codec` joins them. The row of the command table that has
the same operation says what the command does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from google.protobuf.message import Message

from stampede_rt_supernode.core.commands import Operation, Success

Op = TypeVar("Op", bound=Operation)
Done = TypeVar("Done", bound=Success)
OperationMessage = TypeVar("OperationMessage", bound=Message)
ResultMessage = TypeVar("ResultMessage", bound=Message)


@dataclass(frozen=True, kw_only=True, slots=True)
class KindCodec(Generic[Op, OperationMessage, Done, ResultMessage]):
    """The members of the contract that carry the operation and its result, and the values to and from them."""

    kind: str  # the member of DirectoryCommand.kind
    outcome: str  # the member of DirectoryResult.outcome
    operation: type[Op]
    result: type[Done]
    write: Callable[[Op], OperationMessage]
    read: Callable[[OperationMessage], Op]  # raises InvalidArgument
    write_result: Callable[[Done], ResultMessage]
    read_result: Callable[[ResultMessage], Done]
