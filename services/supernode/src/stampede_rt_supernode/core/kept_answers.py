"""The answers to the latest operations, so that a repeated request gets its answer without a second effect. Pure.

The replicas share no clock that shows the age of an operation. So the leader puts marks into the log, at most one in
each MARK_NANOS of its own clock. Every replica keeps the last MARKS_KEPT marks, and forgets the operations before the
oldest of these marks. So all replicas forget an operation at the same log position.

No replica performs a forgotten operation again. A supernode refuses requests that were first sent REPEAT_NANOS_MAX ago
or earlier (calls.py). And the directory refuses a command whose request came to its supernode before the second-newest
mark (`check_not_late`). At least 40 s lie between a forgotten operation and that mark, which is 10 s more than the
greatest age of a request.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

from stampede_rt.errors import InvalidArgument, Overloaded, Unavailable
from stampede_rt_supernode.core.channels.commands import ChannelDeleted
from stampede_rt_supernode.core.commands import Success
from stampede_rt_supernode.core.groups.commands import GroupOpened, GroupUpdated

# How long a caller may repeat an update after its first attempt. Part of the contract (directory_service.proto).
REPEAT_NANOS_MAX = 30 * 10**9
MARK_NANOS = 10 * 10**9
MARKS_KEPT = 6

BYTES_MAX = 64 << 20  # the most memory for answers
CALLER_BYTES_MAX = BYTES_MAX // 2  # the most memory for the answers to one caller
ANSWER_BYTES = 512  # the estimated memory for one answer
MEMBER_BYTES = 64  # the estimated memory for each member, if the answer has a group, and for the name of a group
FORGOTTEN_PER_COMMAND = 64  # the most answers that each command forgets
FORGOTTEN_BY_MARK = 4096  # the most answers that each mark forgets


@dataclass(frozen=True, slots=True)
class KeptAnswer:
    """The answer to an operation. `index`: the log position of its command.

    `subject`: see `command_table.subject_of`. `caller`: the caller whose share of the memory the answer takes up; empty
    if the answer counts for no share.
    """

    op_id: bytes
    index: int
    subject: str
    result: Success
    caller: str = ""

    @property
    def size_bytes(self) -> int:
        """The approximate bytes that this answer takes in memory. Every replica computes the same number."""
        if isinstance(self.result, (GroupOpened, GroupUpdated)):
            return ANSWER_BYTES + MEMBER_BYTES * len(self.result.group.spec.channel_ids)
        if isinstance(self.result, ChannelDeleted):
            return ANSWER_BYTES + sum(MEMBER_BYTES + len(name) for name in self.result.freed_groups or ())
        return ANSWER_BYTES


class KeptAnswers:
    """The answers to the operations since the oldest mark. Refusals are not kept, because they changed nothing."""

    def __init__(self, answers: Iterable[KeptAnswer] = (), marks: Iterable[int] = ()) -> None:
        self.marks = tuple(marks)  # the log positions of the last marks, ascending
        self._answers: dict[bytes, KeptAnswer] = {}  # by operation id, in the order of log positions
        self._size_bytes = 0
        self._size_of: Counter[str] = Counter()  # by caller, for callers with a name
        for answer in answers:
            self.remember(answer)

    def __iter__(self) -> Iterator[KeptAnswer]:
        return iter(self._answers.values())

    def __len__(self) -> int:
        return len(self._answers)

    def newest_first(self) -> Iterator[KeptAnswer]:
        """The answers, in descending order of log positions."""
        return reversed(self._answers.values())

    @property
    def known_since(self) -> int:
        """The log position after which all answers are kept; 0 while there are fewer than MARKS_KEPT marks."""
        return self.marks[0] if len(self.marks) == MARKS_KEPT else 0

    @property
    def last_mark(self) -> int:
        """The log position of the last mark; 0 if there is no mark."""
        return self.marks[-1] if self.marks else 0

    def find(self, op_id: bytes, subject: str) -> Success | None:
        """The result of the operation with that id; None if it is not kept.

        Raises InvalidArgument if its subject differs.
        """
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

    def check_not_late(self, as_of_index: int) -> None:
        """Check that a command does not come too late. `as_of_index`: see Command.

        Raises Unavailable with reason AMBIGUOUS if the supernode got the request before the second-newest mark.
        """
        if 0 < as_of_index < (self.marks[-2] if len(self.marks) > 1 else 0):
            raise Unavailable(
                "the request was under way for too long, and the directory did not perform it this time; send it again "
                "with the same request id, within 30 s after the first time",
                reason="AMBIGUOUS",
            )

    def check_room(self, caller: str) -> None:
        """Raises Overloaded if the memory for answers is full, or if the answers to this caller take up its share."""
        if self._size_bytes >= BYTES_MAX:
            raise Overloaded(
                f"the directory remembers {len(self._answers)} updates of the last minute, as many as it can; wait a "
                "little, and send the request again"
            )
        used = self._size_of[caller]
        if caller and used >= CALLER_BYTES_MAX:
            raise Overloaded(
                f"the directory's answers to the updates of {caller} in the last minute take {used} bytes, the most "
                "for one caller; wait a little, and send the request again",
                metadata={"subject": caller, "used": str(used), "limit": str(CALLER_BYTES_MAX)},
            )

    def remember(self, answer: KeptAnswer) -> None:
        """Keep `answer`. Its log position must be the highest, and its operation id new."""
        self._answers[answer.op_id] = answer
        self._count(answer, answer.size_bytes)

    def _count(self, answer: KeptAnswer, more_bytes: int) -> None:
        self._size_bytes += more_bytes
        if answer.caller:
            self._size_of[answer.caller] += more_bytes
            if not self._size_of[answer.caller]:
                del self._size_of[answer.caller]

    def mark(self, index: int) -> None:
        """Add a mark at `index`, and forget some of the answers before the oldest mark."""
        self.marks = (*self.marks, index)[-MARKS_KEPT:]
        self.forget_some(FORGOTTEN_BY_MARK)

    def forget_some(self, answers_max: int = FORGOTTEN_PER_COMMAND) -> None:
        """Forget a few of the answers that are too old.

        The directory calls this for each command, so that no call takes long.
        """
        oldest = islice(self._answers.values(), answers_max)
        for answer in [answer for answer in oldest if answer.index <= self.known_since]:
            del self._answers[answer.op_id]
            self._count(answer, -answer.size_bytes)
