"""The leases of hosts, or of peers, as their leader keeps them. Pure: every method takes `now`, nanoseconds of a clock
that counts suspension (CLOCK_BOOTTIME).

Renewals leave no trace in the log, so a table is worth something only while its leader leads. What keeps two owners
apart: a host fences itself 0.8 TTL after it *sent* its last acknowledged renewal; the leader ends a lease no earlier
than one TTL after it *received* it; and whoever takes over grants everybody a full TTL first.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from stampede_rt.values.peering import ClockOffset

LEASE_TTL_NANOS = 5 * 10**9
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
    clock: ClockOffset | None = None  # its holder's, as told last; no part of the directory, and gone with the tenure


class LeaseTable:
    """One leader's view. Between `lead` and `resign` it grants and ends leases, outside of it grants nothing."""

    def __init__(self) -> None:
        self.ttl_nanos = LEASE_TTL_NANOS  # the cluster's, once this supernode leads
        self.tenure = 0  # 0: not leading, or the tenure is not committed yet
        self._leases: dict[bytes, _Lease] = {}
        self._looked_nanos = 0

    def lead(self, tenure: int, live: Iterable[Registered], now: int, *, ttl_nanos: int) -> None:
        """The tenure is committed: every live holder has a full TTL from `now`."""
        self.tenure = tenure
        self.ttl_nanos = ttl_nanos
        self._leases.clear()
        self._looked_nanos = now
        self.follow(live, now)

    def resign(self) -> None:
        """This supernode does not lead any more: nothing can be granted or ended."""
        self.tenure = 0
        self._leases.clear()

    def follow(self, live: Iterable[Registered], now: int) -> None:
        """Take note of the live holders: a registration not seen before gets a full TTL, one that is gone is dropped.

        Later than the registration itself, which only makes the lease longer.
        """
        if not self.tenure:
            return
        by_id = {one.holder_id: one for one in live}
        for gone in [one for one in self._leases if one not in by_id]:
            del self._leases[gone]
        for one in by_id.values():
            self._lease_of(one, now)

    def _lease_of(self, holder: Registered, now: int) -> _Lease:
        held = self._leases.get(holder.holder_id)
        if held is None or held.registered_index != holder.registered_index:
            held = _Lease(holder.boot_incarnation, holder.registered_index, now + self.ttl_nanos)
            self._leases[holder.holder_id] = held
        return held

    def renew(self, holder: Registered, received: int, clock: ClockOffset | None = None) -> bool:
        """Prolong the lease of a live holder's registration to `received` + TTL. False: its end is proposed already,
        and only a new registration can help. `clock` is what the holder tells of its own.

        The caller asks for this, and acknowledges it, only after a confirmed read that began after it was received.
        """
        held = self._lease_of(holder, received)
        if held.ending:
            return False
        held.ends_nanos = max(held.ends_nanos, received + self.ttl_nanos)
        held.clock = clock
        return True

    def note_clock(self, holder: Registered, clock: ClockOffset, now: int) -> None:
        """The clock report of a live holder, from its registration."""
        if self.tenure:
            self._lease_of(holder, now).clock = clock

    def clock(self, holder: Registered) -> ClockOffset | None:
        """The last clock report of a holder; None: none, or not to this leader."""
        held = self._leases.get(holder.holder_id)
        return held.clock if held is not None and held.registered_index == holder.registered_index else None

    def due(self, now: int) -> list[tuple[bytes, int, int]]:
        """(holder id, boot incarnation, registered index) of the leases that end now; they are renewed no more.

        Given out again by later calls until `follow` sees the holder gone, since a proposal can fail. A leader that was
        itself stalled could not hear anybody: it grants a full TTL to all instead.
        """
        stalled = now - self._looked_nanos > self.ttl_nanos // STALL_FRACTION
        self._looked_nanos = now
        if stalled:
            self._grant_all(now)
        ended = [(holder_id, lease) for holder_id, lease in self._leases.items() if lease.ends_nanos <= now]
        for _, lease in ended:
            lease.ending = True
        return [(holder_id, lease.boot_incarnation, lease.registered_index) for holder_id, lease in ended]

    def _grant_all(self, now: int) -> None:
        for lease in self._leases.values():
            if not lease.ending:
                lease.ends_nanos = max(lease.ends_nanos, now + self.ttl_nanos)
