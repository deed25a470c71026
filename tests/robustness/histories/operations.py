"""The records of a history: the calls of callers and their answers, with times of one monotonic clock."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Operation:
    """One call.

    If the outcome is unknown, `returned` is infinite and `answer` is None: the call may take effect at any time after
    `invoked`, or never. The history leaves out calls that certainly had no effect. If such a call had an effect after
    all, no order of the operations explains the later answers.
    """

    key: str
    call: Any
    invoked: float
    returned: float = math.inf
    answer: Any = None

    @property
    def ambiguous(self) -> bool:
        """Whether the caller does not know the outcome."""
        return self.returned == math.inf


@dataclass
class Recorder:
    """Records operations. `clock` is the one clock of all callers."""

    clock: Callable[[], float]
    operations: list[Operation] = field(default_factory=list)

    def done(self, key: str, call: object, invoked: float, answer: object) -> None:
        """Record a call that was answered just now."""
        self.operations.append(Operation(key, call, invoked, self.clock(), answer))

    def ambiguous(self, key: str, call: object, invoked: float) -> None:
        """Record a call that the caller gave up. It may have had its effect."""
        self.operations.append(Operation(key, call, invoked))


def by_key(operations: Iterable[Operation]) -> dict[str, list[Operation]]:
    """The operations of each key. A history is linearizable if the history of each key is (Herlihy and Wing 1990)."""
    histories: dict[str, list[Operation]] = defaultdict(list)
    for operation in operations:
        histories[operation.key].append(operation)
    return histories
