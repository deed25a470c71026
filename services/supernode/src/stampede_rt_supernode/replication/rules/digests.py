"""Compares the members' digests, to find replicas whose state differs from the state of most members.

A digest is a hash of all results that a replica has computed up to one position of the log.

Replicas apply the same commands in the same order. If all of them give each command the same effect, they have the same
state. But a release that does not know a command refuses the command, and its state then differs. The log itself does
not show the difference, because it contains commands, not results.

The leader names a position for a while. The members answer with their digests at that position. The leader sends all
members the digest that more than half of them have. A member with another digest has diverged, even if it leads. While
no digest has a majority, a member that differs from the leader is only in doubt (decision 0111). Pure.

A state from a snapshot of an earlier release has no digest. A replica with such a state adopts the leader's digest when
the replica has reached the position of that digest. The members then compare the replica's later digests, too.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection

from stampede_rt_supernode.replication.wire.messages import NO_DIGEST, StateDigest

# How many of its own digests a replica remembers, for the latest positions.
DIGESTS_MAX = 4096
# The leader names a newer position as soon as all connected members have answered for the last one. It waits
# ASKED_SECONDS_MIN at least. After ASKED_SECONDS_MAX it no longer waits for missing answers.
ASKED_SECONDS_MIN, ASKED_SECONDS_MAX = 0.5, 5.0


class Digests:
    """The latest digests of this replica, and the leader's latest statements. Tick thread only."""

    def __init__(self, adopt: Callable[[bytes], None]) -> None:
        """`adopt` sets the digest of this replica's state machine, if the state machine has none."""
        self._adopt = adopt
        # The first position at which this replica's state was found to differ from the state of most members; 0 as long
        # as no difference was found. Never reset.
        self.diverged_at = 0
        # The first position at which this replica's state differs from the leader's, while no digest has a majority; 0
        # if it does not differ.
        self.doubtful_at = 0
        # The answer to the leader: the latest position that the leader has named and this replica has reached, and this
        # replica's digest there.
        self.answer: StateDigest = NO_DIGEST
        self._own: dict[int, bytes] = {}  # by position, ascending
        # The leader's digest at a position that this replica has yet to reach.
        self._leaders_digest: StateDigest | None = None

    def note(self, index: int, digest: bytes) -> None:
        """Note the digest of this replica after all entries up to `index`."""
        self._own[index] = digest
        if len(self._own) > DIGESTS_MAX:
            del self._own[next(iter(self._own))]
        if self._leaders_digest is not None and index >= self._leaders_digest[0]:
            awaited, self._leaders_digest = self._leaders_digest, None
            self.compare(*awaited)

    def compare(self, index: int, digest: bytes) -> None:
        """Compare the leader's digest at `index` with this replica's own.

        If this replica has not reached `index` yet, it keeps the leader's digest, and compares the two digests when it
        reaches `index`. Until then it ignores the leader's digests at other positions ahead. It also ignores a position
        whose own digest it has deleted. If its state at its last position has no digest, it adopts the leader's.
        """
        own = self._own.get(index)
        last = next(reversed(self._own), 0)
        if own is None:
            if self._leaders_digest is None and index > last:
                self._leaders_digest = (index, digest)
        elif not digest:
            pass  # the leader's digest is unknown
        elif not own:
            self._take_over_digest(index, digest, last)
        else:
            self.answer = (index, own)
            self.doubtful_at = 0 if own == digest or self.diverged_at else self.doubtful_at or index

    def compare_with_majority(self, index: int, digest: bytes) -> None:
        """Compare this replica's digest at `index` with `digest`, which more than half of all members have there."""
        own = self._own.get(index)
        if not digest or not own:
            return
        self.doubtful_at = 0
        if own != digest:
            self.diverged_at = self.diverged_at or index

    def _take_over_digest(self, index: int, digest: bytes, last: int) -> None:
        if index == last:
            self._own[index] = digest
            self._adopt(digest)


class DigestPoll:
    """The digests of the members at the position that this leader names. Tick thread only.

    Each time that a node begins to lead, it begins with an empty poll.
    """

    def __init__(self) -> None:
        # The position that this leader names at present, and its own digest there.
        self.named_state: StateDigest = NO_DIGEST
        # By member id: the first position at which the member's state differed from this leader's. Empty as soon as a
        # digest has a majority.
        self.doubts: dict[str, int] = {}
        # By member id: the member's digest at the named position.
        self._held: dict[str, bytes] = {}
        # When this leader began to name the position, by the clock of `ask`.
        self._since = float("-inf")

    def ask(self, now: float, state: StateDigest, others: Collection[str]) -> None:
        """Name the position of `state` from now on, if the leader has named the last position for long enough.

        `now` is in seconds. `state`: the leader's present position and digest. `others`: the ids of the connected
        members, for whose answers the leader waits.
        """
        age = now - self._since
        waited = age >= ASKED_SECONDS_MIN and (age >= ASKED_SECONDS_MAX or self._held.keys() >= set(others))
        if state[0] > self.named_state[0] and state[1] and waited:
            self.named_state, self._since = state, now
            self._held.clear()

    def note_answer(self, member_id: str, answer: StateDigest, voters: Collection[str]) -> None:
        """Process the answer of a member. `voters`: the ids of all other voters."""
        index, digest = answer
        if not digest or index != self.named_state[0]:
            return
        self._held[member_id] = digest
        known = bool(self.majority_digest(voters)[1])
        held = {name: at for name, at in self.doubts.items() if not known and name in voters and name != member_id}
        differs = digest != self.named_state[1] and member_id in voters and not known
        self.doubts = {**held, member_id: self.doubts.get(member_id, index)} if differs else held

    def majority_digest(self, voters: Collection[str]) -> StateDigest:
        """The named position, and the digest that more than half of all members have there, this one included.

        NO_DIGEST if no digest is known to have a majority.
        """
        index, own = self.named_state
        if not own:
            return NO_DIGEST
        counted = Counter([own, *(digest for name, digest in self._held.items() if name in voters)])
        digest, count = counted.most_common(1)[0]
        return (index, digest) if 2 * count > len(voters) + 1 else NO_DIGEST

    def ids_with_digest(self, digest: bytes) -> list[str]:
        """The ids of the other members that have this digest at the named position."""
        return [name for name, held in self._held.items() if held == digest]
