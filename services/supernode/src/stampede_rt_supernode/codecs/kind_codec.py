"""One row of the command codec: the form of one kind of command and of its result in the log. Makes no decisions.

Each family of commands exports its rows as `CODECS`. `command_codec` joins them. The row of the command table with the
same operation defines the command's effect.
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
    """The fields of the protobuf messages for an operation and its result, and the conversions from and to them."""

    kind: str  # the member of DirectoryCommand.kind
    outcome: str  # the member of DirectoryResult.outcome
    operation: type[Op]
    result: type[Done]
    write: Callable[[Op], OperationMessage]
    read: Callable[[OperationMessage], Op]  # raises InvalidArgument
    write_result: Callable[[Done], ResultMessage]
    read_result: Callable[[ResultMessage], Done]
