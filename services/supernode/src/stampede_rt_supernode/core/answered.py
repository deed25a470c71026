"""The deeds done lately, by operation id, so that a repeated request repeats the answer and not the deed. Pure.

Bounded by log positions, not by time: every replica forgets the same ones at the same moment.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from stampede_rt.errors import InvalidArgument
from stampede_rt_supernode.core.commands import Success

WINDOW_INDEXES = 10_000


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of an operation. `subject`: see `commands.subject_of`."""

    op_id: bytes
    index: int
    subject: str
    result: Success


class Answered:
    """Operations of the last `window_indexes` log positions. Refusals are not kept: they changed nothing."""

    def __init__(self, *, window_indexes: int = WINDOW_INDEXES) -> None:
        self._window_indexes = window_indexes
        self._answers: dict[bytes, Answer] = {}  # in the order of their indexes

    def __iter__(self) -> Iterator[Answer]:
        return iter(self._answers.values())

    def __len__(self) -> int:
        return len(self._answers)

    def newest_first(self) -> Iterator[Answer]:
        """In falling order of their indexes."""
        return reversed(self._answers.values())

    def find(self, op_id: bytes, subject: str) -> Success | None:
        """The result of that operation, or None. Raises InvalidArgument if the id was used for something else."""
        answer = self._answers.get(op_id)
        if answer is None:
            return None
        if answer.subject != subject:
            raise InvalidArgument(
                f"the request id {op_id.hex()} was used before, for another request; choose 16 new random bytes for "
                "each request, and repeat them only with the same one",
                metadata={"request_id": op_id.hex()},
            )
        return answer.result

    def remember(self, answer: Answer) -> None:
        """Keep `answer`, whose index is the highest yet and whose op-id is new."""
        self._answers[answer.op_id] = answer

    def forget_before(self, index: int) -> None:
        """The log has come to `index`: drop what lies outside the window. Amortised O(1)."""
        outdated = []
        for answer in self._answers.values():
            if answer.index > index - self._window_indexes:
                break
            outdated.append(answer.op_id)
        for op_id in outdated:
            del self._answers[op_id]
