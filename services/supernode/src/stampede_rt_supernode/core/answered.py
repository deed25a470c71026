"""The operations done lately, by operation id. A repeated request repeats the answer, not the operation. Pure.

How long ago something was done, no clock tells that all replicas share. So the leader marks the time in the log, once
in MARK_NANOS of its own clock: what was done before the last MARKS_KEPT marks is forgotten, by every replica at the
same position.

What is forgotten is not done again: a supernode takes no request that was first sent REPEAT_NANOS_MAX ago (calls.py),
and a command is refused that its supernode took in before the last mark but one (`check_in_time`). From what is
forgotten to that mark, 40 s have passed, 10 s more than a request may be old.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

from stampede_rt.errors import InvalidArgument, Overloaded, Unavailable
from stampede_rt_supernode.core.commands import Success
from stampede_rt_supernode.core.groups.commands import GroupOpened, GroupUpdated

# How long an update may be repeated after it was first sent. Part of the contract (directory_service.proto).
REPEAT_NANOS_MAX = 30 * 10**9
MARK_NANOS = 10 * 10**9
MARKS_KEPT = 6

BYTES_MAX = 64 << 20
ANSWER_BYTES = 512
MEMBER_BYTES = 64
FORGOTTEN_AT_ONCE = 64  # by each command, and by each mark:
FORGOTTEN_BY_MARK = 4096


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to an operation. `subject`: see `commands.subject_of`."""

    op_id: bytes
    index: int
    subject: str
    result: Success

    @property
    def size_bytes(self) -> int:
        """The bytes that it takes, about; the same on every replica."""
        if isinstance(self.result, (GroupOpened, GroupUpdated)):
            return ANSWER_BYTES + MEMBER_BYTES * len(self.result.group.spec.channel_ids)
        return ANSWER_BYTES


class Answered:
    """Operations since the oldest mark. Refusals are not kept: they changed nothing."""

    def __init__(self, answers: Iterable[Answer] = (), marks: Iterable[int] = ()) -> None:
        self.marks = tuple(marks)  # the log positions of the last ones, growing
        self._answers: dict[bytes, Answer] = {}  # in the order of their indexes
        self._size_bytes = 0
        for answer in answers:
            self.remember(answer)

    def __iter__(self) -> Iterator[Answer]:
        return iter(self._answers.values())

    def __len__(self) -> int:
        return len(self._answers)

    def newest_first(self) -> Iterator[Answer]:
        """In falling order of their indexes."""
        return reversed(self._answers.values())

    @property
    def known_since(self) -> int:
        """Everything that was done behind this log position is known."""
        return self.marks[0] if len(self.marks) == MARKS_KEPT else 0

    @property
    def last_mark(self) -> int:
        """Where the last mark is; 0 before the first."""
        return self.marks[-1] if self.marks else 0

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

    def check_in_time(self, as_of_index: int) -> None:
        """Whether a command whose proposer had applied that position (0: not told) may still be done.

        Raises Unavailable with reason AMBIGUOUS if it was under way for longer than the last mark lasted.
        """
        if 0 < as_of_index < (self.marks[-2] if len(self.marks) > 1 else 0):
            raise Unavailable(
                "the request was under way for too long, and nothing was done now; send it again with the same request "
                "id, within 30 s after the first time",
                reason="AMBIGUOUS",
            )

    def check_room(self) -> None:
        """Raises Overloaded if no more can be remembered for as long as is promised."""
        if self._size_bytes >= BYTES_MAX:
            raise Overloaded(
                f"the directory remembers {len(self._answers)} updates of the last minute, as many as it can; wait a "
                "little, and send the request again"
            )

    def remember(self, answer: Answer) -> None:
        """Keep `answer`, whose index is the highest yet and whose op-id is new."""
        self._answers[answer.op_id] = answer
        self._size_bytes += answer.size_bytes

    def mark(self, index: int) -> None:
        """A leader says that the time of a mark has passed since the last one."""
        self.marks = (*self.marks, index)[-MARKS_KEPT:]
        self.forget_some(FORGOTTEN_BY_MARK)

    def forget_some(self, answers_max: int = FORGOTTEN_AT_ONCE) -> None:
        """Drop a few of those that need not be known any more; called with each command, so that none takes long."""
        oldest = islice(self._answers.values(), answers_max)
        for answer in [answer for answer in oldest if answer.index <= self.known_since]:
            del self._answers[answer.op_id]
            self._size_bytes -= answer.size_bytes
