"""What a caller did and what it was told, with times of one monotonic clock: the facts that a history consists of."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Operation:
    """One call. `returned` is infinite and `answer` None if its outcome is unknown: it may take effect at any time
    after `invoked`, or never. Calls that were certainly not done are in no history: an effect of theirs that shows up
    has no explanation then.
    """

    key: str
    call: Any
    invoked: float
    returned: float = math.inf
    answer: Any = None

    @property
    def ambiguous(self) -> bool:
        """Whether the caller does not know what came of it."""
        return self.returned == math.inf


@dataclass
class Recorder:
    """Takes operations down. `clock` is the one clock of all callers."""

    clock: Callable[[], float]
    operations: list[Operation] = field(default_factory=list)

    def done(self, key: str, call: object, invoked: float, answer: object) -> None:
        """The caller was answered just now."""
        self.operations.append(Operation(key, call, invoked, self.clock(), answer))

    def ambiguous(self, key: str, call: object, invoked: float) -> None:
        """The caller gave up, and what it asked for may or may not have been done."""
        self.operations.append(Operation(key, call, invoked))


def by_key(operations: Iterable[Operation]) -> dict[str, list[Operation]]:
    """The operations of each key. A history is linearizable if each key's is (Herlihy and Wing 1990, locality)."""
    histories: dict[str, list[Operation]] = defaultdict(list)
    for operation in operations:
        histories[operation.key].append(operation)
    return histories
