"""Hands the leadership over to a member that has the whole log (Ongaro's dissertation, section 3.10)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from stampede_rt_supernode.replication.rules.membership import Membership

# The time for which a leader looks for a successor.
HAND_OVER_SECONDS = 1.0


@dataclass(slots=True)
class HandOver:
    """A caller's request for another leader. `done` is called once, with True if this node does not lead (any more)."""

    done: Callable[[bool], None]


@dataclass(slots=True)
class _SuccessorSearch:
    """The search for a successor, which ends at `deadline_seconds`. New proposals wait meanwhile.

    As soon as a member has all entries, the leader asks this member to lead. `has_requested_election` is then True.
    """

    deadline_seconds: float
    has_requested_election: bool = False
    callers: list[HandOver] = field(default_factory=list)


class LeadershipTransfer:
    """Looks for a successor when callers ask for one. Tick thread only."""

    def __init__(
        self,
        node: Membership,
        clock: Callable[[], float],
        finish: Callable[[Callable[[], None]], None],
        *,
        alive_seconds: float,
    ) -> None:
        """A member that has answered the leader within `alive_seconds` may become the successor.

        `finish(call)` makes the call as soon as the changes of this step are durable.
        """
        self._node = node
        self._clock = clock
        self._finish_later = finish
        self._alive_seconds = alive_seconds
        self._search: _SuccessorSearch | None = None

    @property
    def under_way(self) -> bool:
        """Whether the leader looks for a successor."""
        return self._search is not None

    def begin(self, request: HandOver) -> None:
        """Begin to look for a successor, or add the caller to the callers that wait for one.

        Answers True without a search if this node does not lead, and False if no other member votes.
        """
        if not self._node.is_leader or not self._node.voter_ids():
            self._answer([request], not self._node.is_leader)
            return
        if self._search is None:
            self._search = _SuccessorSearch(self._clock() + HAND_OVER_SECONDS)
        self._search.callers.append(request)

    def advance(self) -> None:
        """Take the next step, if the leader looks for a successor."""
        search = self._search
        if search is None:
            return
        if self._clock() > search.deadline_seconds:
            self._search = None
            self._answer(search.callers, False)
            return
        alive = self._node.alive_voters(within_seconds=self._alive_seconds)
        complete = sorted(name for name in alive if self._node.held_by(name) == self._node.log.last_index)
        if complete and not search.has_requested_election:
            search.has_requested_election = self._node.send_timeout_now(complete[0])

    def end(self) -> None:
        """Answer all waiting callers, because this node no longer leads, or is closing."""
        search, self._search = self._search, None
        if search is not None:
            self._answer(search.callers, not self._node.is_leader)

    def _answer(self, callers: list[HandOver], has_left_lead: bool) -> None:
        for caller in callers:
            self._finish_later(lambda caller=caller: caller.done(has_left_lead))  # type: ignore[misc]
