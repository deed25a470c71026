"""When a cut event is due (paper, section 3.3, Figure 7; decision 0011). Pure.

One host decides for a subscription. Every value that the cut takes asks for an event; it is due when all members have
come as far, or when they were waited for long enough. What is due at once becomes one event, so that a slow reader gets
merged ones.

A member has come as far when its newest item or an advance has: what a duration says is no promise. So with a bound of
"end", where the cut lies ahead of items, an event waits for the next ones; a small max_wait has it at once. With a
lateness the newest item has to be by so much past the cut: what comes out of order by no more is in the event; and an
event may reach up to where all have come so far.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.group.cut import CutMember

MAX_WAIT_NANOS_DEFAULT = 1_000_000_000
PENDING_MAX = 256


class Boundary(NamedTuple):
    """A decided event: it brings what became visible before `cut`. `incomplete`: members that were not as far."""

    cut: int
    incomplete: tuple[bytes, ...] = ()


class EventDecider:
    """Of one subscription. After each change of cut and members, and at `wake_at`: `note`, then `due`."""

    def __init__(
        self, cut: int | None, max_wait_nanos: int = MAX_WAIT_NANOS_DEFAULT, lateness_nanos: int = 0
    ) -> None:  # fmt: skip
        """Events from `cut` on; None: nothing is visible yet. A cut waits for both times at the most."""
        self._decided = cut
        self._max_wait_nanos = max_wait_nanos + lateness_nanos
        self._lateness_nanos = lateness_nanos
        self._pending: deque[tuple[int, int]] = deque()  # cuts without an event, ascending, and when each was reached

    def note(self, cut: int | None, now: int) -> None:
        """The cut has come so far. Of too many that wait, those become one that were reached at about the same time."""
        last = self._pending[-1][0] if self._pending else self._decided
        if cut is None or (last is not None and cut <= last):
            return
        if len(self._pending) >= PENDING_MAX:
            self._merge(now)
        self._pending.append((cut, now))

    def _merge(self, now: int) -> None:
        """Of the cuts of each stretch of the wait the last stays, so that none waits for longer than a stretch more."""
        waited = max(self._max_wait_nanos, now - self._pending[0][1])
        stretch = waited // (PENDING_MAX // 2) + 1
        self._pending = deque({reached // stretch: (cut, reached) for cut, reached in self._pending}.values())

    def due(self, members: Iterable[CutMember], now: int) -> Boundary | None:
        """The event that is due, if one is. A member that is idle is not waited for."""
        present = list(members)
        decided: int | None = None
        while self._pending and self._is_due(*self._pending[0], present, now):
            decided = self._pending.popleft()[0]
        decided = self._between(decided, present)
        if decided is None:
            return None
        self._decided = decided
        return Boundary(decided, tuple(one.channel_id for one in present if self._is_behind(one, decided)))

    def wake_at(self) -> int | None:
        """When the first cut has waited long enough; None: none waits."""
        return self._pending[0][1] + self._max_wait_nanos if self._pending else None

    def _is_due(self, cut: int, reached: int, members: list[CutMember], now: int) -> bool:
        if now >= reached + self._max_wait_nanos:
            return True
        return not any(self._is_behind(member, cut) and not member.is_idle for member in members)

    def _between(self, decided: int | None, members: list[CutMember]) -> int | None:
        """With a lateness: where all members have come, short of the next cut. It may be far, as after a jump."""
        last = self._decided if decided is None else decided
        come = [self._come(one) for one in members if not one.is_idle]
        known = [one for one in come if one is not None]
        if not self._lateness_nanos or not self._pending or not known or len(known) < len(come):
            return decided
        return min(known) if last is None or min(known) > last else decided

    def _is_behind(self, member: CutMember, cut: int) -> bool:
        come = self._come(member)
        return come is None or come < cut

    def _come(self, member: CutMember) -> int | None:
        """Up to where all items of a member have come; None: unknown."""
        if member.heard is None:
            return None
        newest, advance = member.heard.times.newest, member.heard.times.advance
        known = [] if newest is None else [clamp(newest - self._lateness_nanos)]
        return max(known if advance is None else [*known, advance], default=None)
