"""Whether this replica's state is that of most members: digests of what they have applied, compared at one position.

Replicas do the same commands in the same order, and so come to the same state, as long as they are of one mind about
what a command does. A release that does not know one refuses what the others do, and nothing in the log tells.

The leader names a position for a while, the members answer with their digests there, and the leader tells what more
than half of all hold. Who holds another digest has diverged, the leader, too. As long as no digest has so many, a
member that differs from the leader is only in doubt (decision 0111). Pure.

A state from a snapshot of an earlier release has no digest. It goes on from the leader's as soon as both are at one
position, and is compared from there on.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection

from stampede_rt_supernode.replication.wire.messages import NO_DIGEST, StateDigest

DIGESTS_MAX = 4096
# How long the leader names one position at least, and at most if not all have answered: who lags may need longer.
ASKED_SECONDS_MIN, ASKED_SECONDS_MAX = 0.5, 5.0


class Digests:
    """The last digests of this replica, and what its leader said last. Tick thread only."""

    def __init__(self, adopt: Callable[[bytes], None]) -> None:
        """`adopt` gives a state without a digest the one from which it goes on."""
        self._adopt = adopt
        # Where this replica's state was found to differ from that of most members; 0: nowhere. It stays so.
        self.diverged_at = 0
        # Where it was found to differ from the leader's, while nobody knows what most hold; 0: nowhere.
        self.doubtful_at = 0
        # What this replica holds at the position that the leader named last, once it has come so far.
        self.answer: StateDigest = NO_DIGEST
        self._own: dict[int, bytes] = {}  # by position, growing
        self._told: StateDigest | None = None  # what lies ahead of this replica

    def note(self, index: int, digest: bytes) -> None:
        """This replica has applied everything up to `index`."""
        self._own[index] = digest
        if len(self._own) > DIGESTS_MAX:
            del self._own[next(iter(self._own))]
        if self._told is not None and index >= self._told[0]:
            told, self._told = self._told, None
            self.told(*told)

    def told(self, index: int, digest: bytes) -> None:
        """The leader has come to `digest` at `index`. A position that this replica does not know is passed over."""
        own = self._own.get(index)
        last = next(reversed(self._own), 0)
        if own is None:
            if self._told is None and index > last:
                self._told = (index, digest)
        elif not digest:
            pass  # the leader's is not known
        elif not own:
            self._go_on_from(index, digest, last)
        else:
            self.answer = (index, own)
            self.doubtful_at = 0 if own == digest or self.diverged_at else self.doubtful_at or index

    def told_of_most(self, index: int, digest: bytes) -> None:
        """More than half of all members have come to `digest` at `index`."""
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
    """The digests of the members at the position that this leader names. Anew with each leadership; tick thread
    only."""

    def __init__(self) -> None:
        self.asked: StateDigest = NO_DIGEST
        # By member that differs from this leader while nobody knows what most hold, where it was found.
        self.doubts: dict[str, int] = {}
        self._held: dict[str, bytes] = {}
        self._since = float("-inf")

    def ask(self, now: float, state: StateDigest, others: Collection[str]) -> None:
        """Name the leader's present `state` from now on, if the one before was named long enough for `others`."""
        age = now - self._since
        waited = age >= ASKED_SECONDS_MIN and (age >= ASKED_SECONDS_MAX or self._held.keys() >= set(others))
        if state[0] > self.asked[0] and state[1] and waited:
            self.asked, self._since = state, now
            self._held.clear()

    def answered(self, member_id: str, answer: StateDigest, voters: Collection[str]) -> None:
        """A member holds `answer`. `voters`: all others that are counted."""
        index, digest = answer
        if not digest or index != self.asked[0]:
            return
        self._held[member_id] = digest
        known = bool(self.of_most(voters)[1])
        held = {name: at for name, at in self.doubts.items() if not known and name in voters and name != member_id}
        differs = digest != self.asked[1] and member_id in voters and not known
        self.doubts = {**held, member_id: self.doubts.get(member_id, index)} if differs else held

    def of_most(self, voters: Collection[str]) -> StateDigest:
        """The digest of more than half of all members, this one included, at the position; NO_DIGEST: nobody knows."""
        index, own = self.asked
        if not own:
            return NO_DIGEST
        counted = Counter([own, *(digest for name, digest in self._held.items() if name in voters)])
        digest, count = counted.most_common(1)[0]
        return (index, digest) if 2 * count > len(voters) + 1 else NO_DIGEST

    def agreeing(self, digest: bytes) -> list[str]:
        """The members that hold this digest."""
        return [name for name, held in self._held.items() if held == digest]
