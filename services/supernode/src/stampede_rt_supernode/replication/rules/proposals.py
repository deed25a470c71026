"""Commands on their way into the log, and the outcomes that the callers get."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable

from stampede_rt_supernode.replication.interface import LogUnavailable, OutcomeUnknown
from stampede_rt_supernode.replication.library.node import ProposalDone, ProposalFailure

Outcome = bytes | LogUnavailable | OutcomeUnknown


class Proposal:
    """One command. `done` is called at most once, on the tick thread. `deadline` is by the replica's clock.

    The tick thread sets `submitted` when it gives the command to the library, and `finished` when nothing more will
    be done with the proposal. The caller sets `abandoned` when the caller no longer waits. Each thread writes its own
    field before it reads the other's. So a caller that finds `submitted` False knows that the library will never get
    the command.
    """

    __slots__ = ("abandoned", "command", "deadline", "done", "finished", "submitted")

    def __init__(self, command: bytes, deadline: float, done: Callable[[Outcome], None]) -> None:
        self.command = command
        self.deadline = deadline
        self.done = done
        self.submitted = False
        self.abandoned = False
        self.finished = False


class Proposals:
    """Keeps commands until there is a leader, submits them to the library, and turns its answers into outcomes.

    Tick thread only.

    Invariant: `_submitted` counts the unfinished proposals in the library, at most `submitted_max`.
    """

    def __init__(
        self,
        submit: Callable[[bytes, ProposalDone], None],
        finish: Callable[[Callable[[], None]], None],
        *,
        submitted_max: int,
    ) -> None:
        """`submit` gives a command to the library.

        `finish(call)` makes the call as soon as the changes of this step are durable. The library holds `submitted_max`
        unfinished proposals at most.
        """
        self._submit = submit
        self._finish_later = finish
        self._submitted_max = submitted_max
        self._waiting: deque[Proposal] = deque()
        self._submitted = 0
        # A heap of (deadline, number, proposal). The number decides the order of equal deadlines.
        self._deadlines: list[tuple[float, int, Proposal]] = []
        self._sequence = 0

    @property
    def is_idle(self) -> bool:
        """Whether no proposal waits for a leader or for its answer."""
        return not self._waiting and not self._submitted

    def add(self, proposal: Proposal) -> None:
        """Accept a proposal."""
        self._waiting.append(proposal)
        self._sequence += 1
        heapq.heappush(self._deadlines, (proposal.deadline, self._sequence, proposal))

    def advance(self, *, leader_reachable: bool, now: float) -> None:
        """Give up the proposals whose time is over. If the leader is reachable, submit the waiting proposals."""
        while self._deadlines and (self._deadlines[0][0] <= now or self._deadlines[0][2].finished):
            self._expire(heapq.heappop(self._deadlines)[2])
        for _ in range(len(self._waiting)):
            if not leader_reachable or self._submitted >= self._submitted_max:
                return
            self._submit_one(self._waiting.popleft())

    def _expire(self, proposal: Proposal) -> None:
        if proposal.finished:
            return
        if proposal.submitted:
            self._submitted -= 1
            self._finish(proposal, OutcomeUnknown("the log did not answer in time; the command may still be applied"))
        else:
            self._finish(proposal, LogUnavailable("no leader was found in time; the command was not taken"))

    def _submit_one(self, proposal: Proposal) -> None:
        if proposal.finished:
            return
        proposal.submitted = True
        if proposal.abandoned:
            proposal.finished = True
            return
        self._submitted += 1
        self._submit(proposal.command, lambda answer: self._on_answer(proposal, answer))

    def _on_answer(self, proposal: Proposal, answer: bytes | ProposalFailure) -> None:
        if proposal.finished:
            return
        self._submitted -= 1
        if answer is ProposalFailure.NOT_TAKEN:
            # The command is certainly not applied. It waits for the next leader, until its own deadline.
            proposal.submitted = False
            self._waiting.append(proposal)
        elif answer is ProposalFailure.UNKNOWN:
            self._finish(proposal, OutcomeUnknown("the leader changed during the command, which may still be applied"))
        else:
            self._finish(proposal, answer)

    def _finish(self, proposal: Proposal, outcome: Outcome) -> None:
        proposal.finished = True
        self._finish_later(lambda: proposal.done(outcome))

    def close(self) -> None:
        """Finish all proposals with LogUnavailable or OutcomeUnknown."""
        for _, _, proposal in self._deadlines:
            if proposal.finished:
                continue
            what = OutcomeUnknown if proposal.submitted else LogUnavailable
            self._finish(proposal, what("this replica is closing"))
        self._deadlines.clear()
        self._waiting.clear()
