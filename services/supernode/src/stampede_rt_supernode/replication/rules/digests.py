"""Compares digests of the applied results at one position, to find whether this replica's state is that of most
members.

Replicas apply the same commands in the same order. So they reach the same state, as long as they agree on the effect of
each command. But a release that does not know a command refuses it, and the log does not show the difference.

The leader names a position for a while. The members answer with their digests at that position. The leader tells all
members the digest that more than half of them have. A member with another digest has diverged, the leader included.
While no digest has a majority, a member that differs from the leader is only in doubt (decision 0111). Pure.

A state from a snapshot of an earlier release has no digest. It takes over the leader's digest as soon as both are at
one position. From there on it is compared.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection

from stampede_rt_supernode.replication.wire.messages import NO_DIGEST, StateDigest

DIGESTS_MAX = 4096
# The leader names one position until all members have answered, but for the first time at least, and for the second
# time at most.
ASKED_SECONDS_MIN, ASKED_SECONDS_MAX = 0.5, 5.0


class Digests:
    """The latest digests of this replica, and the leader's latest statements. Tick thread only."""

    def __init__(self, adopt: Callable[[bytes], None]) -> None:
        """`adopt` sets the digest of a state machine that has none."""
        self._adopt = adopt
        # The position at which this replica's state differs from that of most members; 0: none. Never cleared.
        self.diverged_at = 0
        # The position at which this replica's state differs from the leader's, while no digest has a majority; 0: none.
        self.doubtful_at = 0
        # This replica's digest at the position that the leader named last, once this replica has reached it.
        self.answer: StateDigest = NO_DIGEST
        self._own: dict[int, bytes] = {}  # by position, ascending
        self._told: StateDigest | None = None  # a statement of the leader about a later position than this replica's

    def note(self, index: int, digest: bytes) -> None:
        """Note the digest of this replica after all entries up to `index`."""
        self._own[index] = digest
        if len(self._own) > DIGESTS_MAX:
            del self._own[next(iter(self._own))]
        if self._told is not None and index >= self._told[0]:
            told, self._told = self._told, None
            self.told(*told)

    def told(self, index: int, digest: bytes) -> None:
        """Take in the leader's digest at `index`. Ignores a position whose digest this replica does not have."""
        own = self._own.get(index)
        last = next(reversed(self._own), 0)
        if own is None:
            if self._told is None and index > last:
                self._told = (index, digest)
        elif not digest:
            pass  # the leader's digest is unknown
        elif not own:
            self._go_on_from(index, digest, last)
        else:
            self.answer = (index, own)
            self.doubtful_at = 0 if own == digest or self.diverged_at else self.doubtful_at or index

    def told_of_most(self, index: int, digest: bytes) -> None:
        """Take in the digest at `index` of more than half of all members."""
        own = self._own.get(index)
        if not digest or not own:
            return
        self.doubtful_at = 0
        if own != digest:
            self.diverged_at = self.diverged_at or index

    def _go_on_from(self, index: int, digest: bytes, last: int) -> None:
        if index == last:
            self._own[index] = digest
            self._adopt(digest)


class DigestPoll:
    """The digests of the members at the position that this leader names. New for each leadership. Tick thread only."""

    def __init__(self) -> None:
        self.asked: StateDigest = NO_DIGEST
        # For each member whose state differs from this leader's, while no digest has a majority: the position.
        self.doubts: dict[str, int] = {}
        self._held: dict[str, bytes] = {}
        self._since = float("-inf")

    def ask(self, now: float, state: StateDigest, others: Collection[str]) -> None:
        """Name the leader's present `state` from now on, if the last position was named long enough for `others`."""
        age = now - self._since
        waited = age >= ASKED_SECONDS_MIN and (age >= ASKED_SECONDS_MAX or self._held.keys() >= set(others))
        if state[0] > self.asked[0] and state[1] and waited:
            self.asked, self._since = state, now
            self._held.clear()

    def answered(self, member_id: str, answer: StateDigest, voters: Collection[str]) -> None:
        """Take in the answer of a member. `voters`: all other voters."""
        index, digest = answer
        if not digest or index != self.asked[0]:
            return
        self._held[member_id] = digest
        known = bool(self.of_most(voters)[1])
        held = {name: at for name, at in self.doubts.items() if not known and name in voters and name != member_id}
        differs = digest != self.asked[1] and member_id in voters and not known
        self.doubts = {**held, member_id: self.doubts.get(member_id, index)} if differs else held

    def of_most(self, voters: Collection[str]) -> StateDigest:
        """The digest of more than half of all members, this one included, at the named position; NO_DIGEST: unknown."""
        index, own = self.asked
        if not own:
            return NO_DIGEST
        counted = Counter([own, *(digest for name, digest in self._held.items() if name in voters)])
        digest, count = counted.most_common(1)[0]
        return (index, digest) if 2 * count > len(voters) + 1 else NO_DIGEST

    def agreeing(self, digest: bytes) -> list[str]:
        """The members that have this digest."""
        return [name for name, held in self._held.items() if held == digest]
