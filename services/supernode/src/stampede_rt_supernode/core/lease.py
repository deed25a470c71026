"""The leases of hosts, or of peers, as their leader keeps them. Pure: every method takes `now`, nanoseconds of a clock
that counts suspension (CLOCK_BOOTTIME).

Renewals leave no trace in the log, so a table is worth something only while its leader leads. What keeps two owners
apart: a host fences itself 0.8 TTL after it *sent* its last acknowledged renewal; the leader ends a lease no earlier
than one TTL after it *received* it; and whoever takes over grants everybody a full TTL first.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import islice
from typing import Protocol

from stampede_rt.values.peering import ClockOffset

LEASE_TTL_NANOS = 5 * 10**9
LOOKS_MAX = 1024
"""So many leases one call looks at, however many there are."""
MAX_INDEX = 2**63
STALL_FRACTION = 2  # a leader that did not look for TTL / 2 did not hear renewals either


class Registered(Protocol):
    """The holder of a lease: one registration of a host or peer."""

    @property
    def holder_id(self) -> bytes:
        """Whose it is."""

    @property
    def boot_incarnation(self) -> int:
        """Of the process that registered."""

    @property
    def registered_index(self) -> int:
        """The log position of the registration."""


@dataclass(slots=True)
class _Lease:
    boot_incarnation: int
    registered_index: int
    ends_nanos: int
    ending: bool = False  # its end is proposed, and cannot be called back
    walk: int = 0  # the walk over all live holders in which it was seen last
    clock: ClockOffset | None = None  # its holder's, as told last; no part of the directory, and gone with the tenure


class LeaseTable:
    """One leader's view. Between `lead` and `resign` it grants and ends leases, outside of it grants nothing."""

    def __init__(self) -> None:
        self.ttl_nanos = LEASE_TTL_NANOS  # the cluster's, once this supernode leads
        self.tenure = 0  # 0: not leading, or the tenure is not committed yet
        self._leases: dict[bytes, _Lease] = {}
        # Of each lease when it is looked at next, at its end or before; also of some that are gone.
        self._looks: list[tuple[int, int, bytes]] = []
        self._ending: dict[bytes, _Lease] = {}
        self._granted_nanos = 0  # all leases that are not ending last until then
        self._walks = 0
        self._looked_nanos = 0

    def lead(self, tenure: int, live: Iterable[Registered], now: int, *, ttl_nanos: int) -> None:
        """The tenure is committed: every live holder has a full TTL from `now`."""
        self.tenure = tenure
        self.ttl_nanos = ttl_nanos
        self._forget_all()
        self._looked_nanos = now
        self.follow(live, now)

    def resign(self) -> None:
        """This supernode does not lead any more: nothing can be granted or ended."""
        self.tenure = 0
        self._forget_all()

    def _forget_all(self) -> None:
        self._leases.clear()
        self._looks.clear()
        self._ending.clear()
        self._granted_nanos = 0

    def follow(self, live: Iterable[Registered], now: int) -> None:
        """Take note of the live holders: a registration not seen before gets a full TTL, one that is gone is dropped.

        Later than the registration itself, which only makes the lease longer.
        """
        for _ in self.following(list(live), MAX_INDEX, now):
            pass

    def following(self, live: Sequence[Registered], as_of_index: int, now: int) -> Iterator[None]:
        """The same of those that live at that log position, in pieces. What happens since is noted by itself."""
        if not self.tenure:
            return
        self._walks += 1
        walk = self._walks
        for start in range(0, len(live), LOOKS_MAX):
            for one in live[start : start + LOOKS_MAX]:
                self.note(one, now).walk = walk
            yield
        known = list(self._leases)
        for start in range(0, len(known), LOOKS_MAX):
            for holder_id in known[start : start + LOOKS_MAX]:
                held = self._leases.get(holder_id)
                if held is not None and held.walk != walk:
                    self.note_gone(holder_id, as_of_index)
            yield

    def note(self, holder: Registered, now: int) -> _Lease:
        """This holder lives, or did a moment ago: its registration gets a full TTL if it, or a later one, has none."""
        held = self._leases.get(holder.holder_id)
        if held is None or held.registered_index < holder.registered_index:
            held = _Lease(holder.boot_incarnation, holder.registered_index, now + self.ttl_nanos)
            self._leases[holder.holder_id] = held
            self._ending.pop(holder.holder_id, None)
            heappush(self._looks, (held.ends_nanos, held.registered_index, holder.holder_id))
        return held

    def note_gone(self, holder_id: bytes, as_of_index: int) -> None:
        """The holder was gone at that log position. One that has registered since keeps its lease."""
        held = self._leases.get(holder_id)
        if held is not None and held.registered_index <= as_of_index:
            del self._leases[holder_id]
            self._ending.pop(holder_id, None)

    def renew(self, holder: Registered, received: int, clock: ClockOffset | None = None) -> bool:
        """Prolong the lease of a live holder's registration to `received` + TTL. False: its end is proposed already,
        and only a new registration can help. `clock` is what the holder tells of its own.

        The caller asks for this, and acknowledges it, only after a confirmed read that began after it was received.
        """
        held = self.note(holder, received)
        if held.ending:
            return False
        held.ends_nanos = max(held.ends_nanos, received + self.ttl_nanos)
        held.clock = clock
        return True

    def note_clock(self, holder: Registered, clock: ClockOffset, now: int) -> None:
        """The clock report of a live holder, from its registration."""
        if self.tenure:
            self.note(holder, now).clock = clock

    def clock(self, holder: Registered) -> ClockOffset | None:
        """The last clock report of a holder; None: none, or not to this leader."""
        held = self._leases.get(holder.holder_id)
        return held.clock if held is not None and held.registered_index == holder.registered_index else None

    def due(self, now: int) -> list[tuple[bytes, int, int]]:
        """(holder id, boot incarnation, registered index) of the leases that end now; they are renewed no more.

        Given out again by later calls until `follow` sees the holder gone, since a proposal can fail. A leader that was
        itself stalled could not hear anybody: it grants a full TTL to all instead. Of very many the first ones, and
        `is_behind` is True.
        """
        if now - self._looked_nanos > self.ttl_nanos // STALL_FRACTION:
            self._granted_nanos = now + self.ttl_nanos
        self._looked_nanos = now
        for _ in range(LOOKS_MAX):
            if not self.is_behind(now):
                break
            self._look(now)
        return [
            (holder_id, lease.boot_incarnation, lease.registered_index)
            for holder_id, lease in islice(self._ending.items(), LOOKS_MAX)
        ]

    def is_behind(self, now: int) -> bool:
        """Another call of `due` would look at more leases."""
        return bool(self._looks) and self._looks[0][0] <= now and len(self._ending) < LOOKS_MAX

    def _look(self, now: int) -> None:
        _, registered_index, holder_id = heappop(self._looks)
        lease = self._leases.get(holder_id)
        if lease is None or lease.registered_index != registered_index:
            return  # it is gone, or its holder has registered again
        ends_nanos = max(lease.ends_nanos, self._granted_nanos)
        if ends_nanos > now:
            heappush(self._looks, (ends_nanos, registered_index, holder_id))
        else:
            lease.ending = True
            self._ending[holder_id] = lease
