"""The leases of hosts, or of peers, as the leader keeps them.

Pure: a method that needs the time takes `now`, in nanoseconds of a clock that also runs while the machine is suspended
(CLOCK_BOOTTIME). Renewals are not in the log, so a table is valid only while its supernode leads. Two rules prevent two
owners. A host stops serving 0.8 TTL after it *sent* its last acknowledged renewal, and the leader ends a lease at the
earliest one TTL after it *received* the renewal. And a new leader first grants a full TTL to every holder.
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
"""The most leases that one call looks at."""
MAX_INDEX = 2**63  # above all log positions
# A leader that did not call `due` for TTL / STALL_FRACTION was stalled, and could not receive renewals either.
STALL_FRACTION = 2


class RegisteredHolder(Protocol):
    """The holder of a lease: one registration of a host or peer."""

    @property
    def holder_id(self) -> bytes:
        """The id of the host or peer."""

    @property
    def boot_incarnation(self) -> int:
        """The boot incarnation of the process that registered."""

    @property
    def registered_index(self) -> int:
        """The log position of the registration."""


@dataclass(slots=True)
class _Lease:
    boot_incarnation: int
    registered_index: int
    ends_nanos: int
    ending: bool = False  # the end of the lease is proposed, and cannot be withdrawn
    scan: int = 0  # the number of the last scan of all live holders in which this holder was found
    # the holder's last clock report; not part of the directory, and lost with the tenure
    clock: ClockOffset | None = None


class LeaseTable:
    """The leases as one leader keeps them. The table grants and ends leases only between `lead` and `resign`."""

    def __init__(self) -> None:
        self.ttl_nanos = LEASE_TTL_NANOS  # the TTL of the cluster, if this supernode leads
        self.tenure = 0  # 0 while this supernode does not lead, or its tenure is not committed yet
        self._leases: dict[bytes, _Lease] = {}
        # A heap of (time of the next look at a lease, its registered index, its holder's id). The time is never after
        # the lease's end. Some of these leases are dropped already.
        self._looks: list[tuple[int, int, bytes]] = []
        # By holder id: the leases whose end is proposed.
        self._ending: dict[bytes, _Lease] = {}
        # The leases and looks of former tenures that are not freed yet.
        self._forgotten: list[tuple[dict[bytes, _Lease], list[tuple[int, int, bytes]]]] = []
        self._granted_nanos = 0  # all leases that are not ending last at least until then
        self._scans = 0  # the number of the last scan of all live holders
        self._looked_nanos = 0  # when `due` was last called

    def lead(self, tenure: int, live: Iterable[RegisteredHolder], now: int, *, ttl_nanos: int) -> None:
        """Begin a committed tenure: every live holder gets a full TTL from `now`."""
        self.tenure = tenure
        self.ttl_nanos = ttl_nanos
        self._forget_all()
        self._looked_nanos = now
        self.follow(live, now)

    def resign(self) -> None:
        """End the tenure: this supernode does not lead any more, so it must not grant or end leases.

        Iterate over `freeing` afterwards.
        """
        self.tenure = 0
        self._forget_all()

    def _forget_all(self) -> None:
        if self._leases or self._looks:
            self._forgotten.append((self._leases, self._looks))
        self._leases, self._looks, self._ending = {}, [], {}
        self._granted_nanos = 0

    def freeing(self) -> Iterator[None]:
        """Free the leases of former tenures, in pieces."""
        while self._forgotten:
            leases, looks = self._forgotten[-1]
            for _ in range(min(LOOKS_MAX, len(leases))):
                leases.popitem()
            del looks[-LOOKS_MAX:]
            if not leases and not looks:
                self._forgotten.pop()
            yield

    def follow(self, live: Iterable[RegisteredHolder], now: int) -> None:
        """Take over the live holders: a new registration gets a full TTL, and a holder that is gone is dropped.

        The call may come later than a registration; the lease is then only longer.
        """
        for _ in self.following(list(live), MAX_INDEX, now):
            pass

    def following(self, live: Sequence[RegisteredHolder], as_of_index: int, now: int) -> Iterator[None]:
        """Do the work of `follow` in pieces. `live`: the holders that live at log position `as_of_index`.

        The caller reports later changes by `note` and `note_gone`.
        """
        if not self.tenure:
            return
        self._scans += 1
        scan = self._scans
        for start in range(0, len(live), LOOKS_MAX):
            for one in live[start : start + LOOKS_MAX]:
                self.note(one, now).scan = scan
            yield
        known = list(self._leases)
        for start in range(0, len(known), LOOKS_MAX):
            for holder_id in known[start : start + LOOKS_MAX]:
                held = self._leases.get(holder_id)
                if held is not None and held.scan != scan:
                    self.note_gone(holder_id, as_of_index)
            yield

    def note(self, holder: RegisteredHolder, now: int) -> _Lease:
        """Note a live holder.

        Its registration gets a full TTL, unless the table has a lease of this registration or of a later one. Returns
        the lease of the holder.
        """
        held = self._leases.get(holder.holder_id)
        if held is None or held.registered_index < holder.registered_index:
            held = _Lease(holder.boot_incarnation, holder.registered_index, now + self.ttl_nanos)
            self._leases[holder.holder_id] = held
            self._ending.pop(holder.holder_id, None)
            heappush(self._looks, (held.ends_nanos, held.registered_index, holder.holder_id))
        return held

    def note_gone(self, holder_id: bytes, as_of_index: int) -> None:
        """Note that the holder was gone at that log position. A holder that has registered since keeps its lease."""
        held = self._leases.get(holder_id)
        if held is not None and held.registered_index <= as_of_index:
            del self._leases[holder_id]
            self._ending.pop(holder_id, None)

    def renew(self, holder: RegisteredHolder, received: int, clock: ClockOffset | None = None) -> bool:
        """Renew the lease of a live holder's registration to `received` + TTL.

        Returns False if the end of the lease is already proposed: then only a new registration helps. `clock` is the
        holder's report of its clock. Call this, and acknowledge the renewal, only after a confirmed read that began
        after the renewal was received.
        """
        held = self.note(holder, received)
        if held.ending:
            return False
        held.ends_nanos = max(held.ends_nanos, received + self.ttl_nanos)
        held.clock = clock
        return True

    def note_clock(self, holder: RegisteredHolder, clock: ClockOffset, now: int) -> None:
        """Note the clock report in a live holder's registration."""
        if self.tenure:
            self.note(holder, now).clock = clock

    def clock(self, holder: RegisteredHolder) -> ClockOffset | None:
        """The last clock report of a holder to this leader; None if it made none."""
        held = self._leases.get(holder.holder_id)
        return held.clock if held is not None and held.registered_index == holder.registered_index else None

    def due(self, now: int) -> list[tuple[bytes, int, int]]:
        """The (holder id, boot incarnation, registered index) of leases that have run out, LOOKS_MAX at most.

        From now on `renew` refuses to renew them. Later calls return a lease again, because a proposal can fail. They
        stop when its holder is noted as gone, or registers again. If the last call was more than TTL / STALL_FRACTION
        ago, every other lease lasts for a full TTL from `now`. One call looks at LOOKS_MAX leases at most; see
        `is_behind`.
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
        """Whether another call of `due` at `now` would look at more leases."""
        return bool(self._looks) and self._looks[0][0] <= now and len(self._ending) < LOOKS_MAX

    def _look(self, now: int) -> None:
        _, registered_index, holder_id = heappop(self._looks)
        lease = self._leases.get(holder_id)
        if lease is None or lease.registered_index != registered_index:
            return  # the lease is gone, or its holder has registered again
        ends_nanos = max(lease.ends_nanos, self._granted_nanos)
        if ends_nanos > now:
            heappush(self._looks, (ends_nanos, registered_index, holder_id))
        else:
            lease.ending = True
            self._ending[holder_id] = lease
