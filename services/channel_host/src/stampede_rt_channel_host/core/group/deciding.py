"""Decides when a cut event is due (paper, section 3.3, Figure 7; decision 0011). Pure.

One host decides the events of a subscription. Each new cut needs an event. The event is due when all members have
reached the cut, or when the host has waited long enough for them. Cuts that are due together become one event, so that
a slow reader gets merged events.

A member has reached a cut when its newest item or an advance is at the cut or later. Durations do not count. In a group
with `by_end` the cut may be later than all items. Then an event waits for the next items. With a small max_wait the
host sends the event earlier. With a lateness the newest item must be later than the cut by at least this lateness. Then
the event has all late items that are late by at most the lateness. While a cut waits for its members, an event may end
before this cut: at the latest time that all members have reached.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.group.cut import CutMember

MAX_WAIT_NANOS_DEFAULT = 1_000_000_000
"""The time that an event waits for members that have not reached its cut, if the reader states no other time."""
PENDING_MAX = 256
"""The most cuts without an event that a decider keeps."""


class Boundary(NamedTuple):
    """The end of a decided event.

    The event has the items before `cut` that no earlier event had. `incomplete` has the ids of the members that had not
    reached the cut.
    """

    cut: int
    incomplete: tuple[bytes, ...] = ()


class EventDecider:
    """Decides the events of one subscription.

    After each change of the cut or of a member, and at `wake_at`, the caller calls `note` and then `due`.
    """

    def __init__(
        self, cut: int | None, max_wait_nanos: int = MAX_WAIT_NANOS_DEFAULT, lateness_nanos: int = 0
    ) -> None:  # fmt: skip
        """Begin with the events after `cut`, which is None if no item is visible yet.

        A cut waits for its members for `max_wait_nanos` + `lateness_nanos` at the most.
        """
        self._decided = cut
        self._max_wait_nanos = max_wait_nanos + lateness_nanos
        self._lateness_nanos = lateness_nanos
        # the cuts without an event, ascending, each with the time at which the group reached the cut
        self._pending: deque[tuple[int, int]] = deque()

    def note(self, cut: int | None, now: int) -> None:
        """Note the group's present cut.

        If PENDING_MAX cuts wait already, cuts that the group reached at about the same time become one.
        """
        last = self._pending[-1][0] if self._pending else self._decided
        if cut is None or (last is not None and cut <= last):
            return
        if len(self._pending) >= PENDING_MAX:
            self._merge(now)
        self._pending.append((cut, now))

    def _merge(self, now: int) -> None:
        """Divide the time in which the waiting cuts were reached into short parts, and keep the last cut of each part.

        So the wait of a cut becomes longer by at most one such part.
        """
        waited = max(self._max_wait_nanos, now - self._pending[0][1])
        part_nanos = waited // (PENDING_MAX // 2) + 1
        self._pending = deque({reached // part_nanos: (cut, reached) for cut, reached in self._pending}.values())

    def due(self, members: Iterable[CutMember], now: int) -> Boundary | None:
        """The due event, or None. An event does not wait for idle members."""
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
        """The time at which the first waiting cut has waited long enough, or None if no cut waits."""
        return self._pending[0][1] + self._max_wait_nanos if self._pending else None

    def _is_due(self, cut: int, reached: int, members: list[CutMember], now: int) -> bool:
        """Whether the event up to `cut` is due. The group reached the cut at `reached`."""
        if now >= reached + self._max_wait_nanos:
            return True
        return not any(self._is_behind(member, cut) and not member.is_idle for member in members)

    def _between(self, decided: int | None, members: list[CutMember]) -> int | None:
        """The end of the due event: `decided`, or a later time that all members have reached. None if no event is due.

        The later time counts only with a lateness, and only while a cut waits. The waiting cut may be far ahead of the
        members.
        """
        last = self._decided if decided is None else decided
        times = [self._complete_to(one) for one in members if not one.is_idle]
        known = [one for one in times if one is not None]
        if not self._lateness_nanos or not self._pending or not known or len(known) < len(times):
            return decided
        return min(known) if last is None or min(known) > last else decided

    def _is_behind(self, member: CutMember, cut: int) -> bool:
        """Whether the member has not reached the cut."""
        time = self._complete_to(member)
        return time is None or time < cut

    def _complete_to(self, member: CutMember) -> int | None:
        """The time up to which all items of a member have come, or None if it is not known."""
        if member.known is None:
            return None
        newest, advance = member.known.times.newest, member.known.times.advance
        known = [] if newest is None else [clamp(newest - self._lateness_nanos)]
        return max(known if advance is None else [*known, advance], default=None)
