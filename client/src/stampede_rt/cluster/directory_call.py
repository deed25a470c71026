"""One call to the directory: decides which supernode to ask next, how long to wait, and what failures mean. Pure.

The client and the channel host share this module. Their shells make the calls, wait between two rounds, and ask the
front-ends.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from stampede_rt.cluster.majority import why_unserved
from stampede_rt.errors import DeadlineExceeded, NotLeader, StampedeError, Unavailable, VersionMismatch
from stampede_rt.version import PROTOCOL_VERSION

SUPERNODES_MAX = 64
FRONTEND_TIMEOUT_S_MIN = 0.1
SHORT_TRY_S = 1.0  # a supernode that must answer sooner may find no majority in time, although there is one
CUT_SHORT = "cut_short"
"""A key of the metadata of an error. With this key the attempts had no time to find a majority."""


class Attempt(NamedTuple):
    """Ask the supernode at `target`, and wait at most `timeout_s`."""

    target: str
    timeout_s: float


class DirectoryCall:
    """One call from its first attempt to its end. A round asks each supernode at most once.

    All times are seconds of one monotonic clock. The object keeps the latest failure of each supernode, also from
    earlier rounds.
    """

    def __init__(self, deadline_s: float) -> None:
        self._deadline_s = deadline_s
        self._failures: dict[str, StampedeError] = {}  # by target; the latest failure is the last
        self._waiting: deque[str] = deque()  # supernodes that this round has not asked yet
        self._tried: set[str] = set()  # supernodes that this round has asked
        self._attempt_s_max = 0.0
        self._timeouts_s: dict[str, float] = {}  # by target, of its latest attempt

    def begin_round(self, targets: Sequence[str], attempt_s_max: float) -> None:
        """Begin a round that asks the supernodes at `targets` in their order, each for at most `attempt_s_max`."""
        self._waiting, self._tried, self._attempt_s_max = deque(targets), set(), attempt_s_max

    def next_attempt(self, now_s: float) -> Attempt | None:
        """Return the next attempt. None: the round, or the time of the call, is over."""
        left_s = self._deadline_s - now_s
        while self._waiting and left_s > 0 and len(self._tried) < SUPERNODES_MAX:
            target = self._waiting.popleft()
            if target not in self._tried:
                self._tried.add(target)
                self._timeouts_s[target] = min(left_s, self._attempt_s_max)
                return Attempt(target, self._timeouts_s[target])
        return None

    def note_failure(self, target: str, error: StampedeError) -> None:
        """Note that the supernode at `target` did not serve the call. If it named a leader, the leader is next.

        An earlier failure of the same supernode stays if the latest attempt had too little time, and has certainly
        changed nothing. The earlier failure says more. Raises `error` if the call would fail at every supernode.
        """
        if not may_pass(error):
            raise error
        if is_cut_short(error, self._timeouts_s.get(target, SHORT_TRY_S)):
            error.metadata[CUT_SHORT] = "true"
            if target in self._failures and error.reason != "AMBIGUOUS":
                return
        self._failures.pop(target, None)
        self._failures[target] = error
        hint = leader_hint(error)
        if hint:
            self._waiting.appendleft(hint)

    def failure(self, targets: Sequence[str]) -> StampedeError:
        """Return one error that sums up the failures of the supernodes at `targets`. Call this after a round.

        The error has CUT_SHORT if the failures have it.
        """
        known = {target: error for target, error in self._failures.items() if target in targets}
        error = self._summed_up(known, targets)
        if known and all(CUT_SHORT in one.metadata for one in known.values()):
            error.metadata[CUT_SHORT] = "true"
        return error

    def _summed_up(self, known: dict[str, StampedeError], targets: Sequence[str]) -> StampedeError:
        if known:
            return why_unserved(known, len(targets))
        if targets and not self._failures:
            return DeadlineExceeded("no time was left to ask a supernode; give the call more time")
        return [
            Unavailable("no supernode is known; start a front-end and supernodes, or look with `stampede doctor`"),
            *self._failures.values(),
        ][-1]


def may_pass(error: StampedeError) -> bool:
    """Whether the same call may succeed later, or at another supernode."""
    return error.retryable or isinstance(error, DeadlineExceeded)


def is_cut_short(error: StampedeError, timeout_s: float) -> bool:
    """Whether an attempt of at most `timeout_s` seconds failed with `error` because it had too little time."""
    is_about_time = isinstance(error, DeadlineExceeded) or error.reason in ("NO_QUORUM", "AMBIGUOUS")
    return CUT_SHORT in error.metadata or (is_about_time and timeout_s < SHORT_TRY_S)


def leader_hint(error: StampedeError) -> str:
    """Return the address of the leader that the supernode named in its refusal `error`; empty if it named none."""
    return error.metadata.get("leader_endpoint", "") if isinstance(error, NotLeader) else ""


def frontend_timeout_s(left_s: float, frontends: int) -> float:
    """Return the seconds to wait for one front-end, if the caller must ask `frontends` more of them within `left_s`."""
    return max(left_s / frontends, FRONTEND_TIMEOUT_S_MIN)


def check_frontend(target: str, spoken: int, version: str, *, caller: str, caller_version: str) -> None:
    """Raise VersionMismatch unless the front-end at `target` speaks the caller's protocol."""
    if spoken != PROTOCOL_VERSION:
        raise VersionMismatch(
            f"the front-end {target} speaks protocol {spoken} (version {version}), this {caller} {PROTOCOL_VERSION} "
            f"(version {caller_version}); install the same release on both"
        )
