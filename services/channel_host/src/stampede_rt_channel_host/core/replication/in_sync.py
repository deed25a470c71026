"""Which replicas of a channel are in sync, and which items are replicated. Pure.

The directory's log has a flag for each replica. If the owner is lost, a replica with this flag becomes the owner. So a
replica with the flag must hold every item that was acknowledged or shown to a reader. The owner cannot know at which
moment the log takes a change of a flag. So the owner begins to wait for a replica before it asks the directory to set
the flag. The owner stops waiting only when the log has confirmed that the flag is cleared.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import NamedTuple

LAG_NANOS_MAX = 1_000_000_000
"""A replica that was silent, or behind, for longer than this loses its flag."""
EARLY_LAG_NANOS_MAX = 800_000_000
"""The same limit for a channel whose puts wait only for replicas that are behind for longer than LAG_NANOS_MAX. The
directory then clears the flag within the rest of that time, so that no put waits.
"""
_NEVER = -(2**62)


class ReplicaState(Enum):
    """The flag of a replica in the directory's log, as the owner knows it."""

    OUT = "out of sync"  # the log has no flag: the owner does not wait for the replica
    JOINING = "joining"  # the log may have the flag
    IN = "in sync"  # the log has the flag
    LEAVING = "leaving"  # the log may still have the flag


class KnownReplica(NamedTuple):
    """A replica as the directory knows it. Its host has a new `boot_incarnation` after each restart.

    `added_index`: the position of its addition in the directory's log; 0: the directory does not say it.
    """

    host_id: bytes
    boot_incarnation: int
    in_sync: bool
    added_index: int = 0


class ReplicaChange(NamedTuple):
    """A flag for the directory to set or to clear.

    The directory ignores a change whose `number` is not above the number of the last change. So a change that comes
    late never overtakes a later one. It also refuses a change whose `added_index` is not that of the present replica:
    the change is about a replica that was removed meanwhile.
    """

    host_id: bytes
    boot_incarnation: int
    in_sync: bool
    number: int
    added_index: int = 0


class _Replica:
    """`next_seq`: it holds all items before this seq. `caught_up`: when it last had all items that the owner had."""

    def __init__(self, known: KnownReplica, owner_next_seq: int, now: int) -> None:
        state = ReplicaState.IN if known.in_sync else ReplicaState.OUT
        self.boot_incarnation = known.boot_incarnation
        self.added_index = known.added_index
        self.state = state
        self.next_seq = 0
        self.caught_up = now if state is ReplicaState.IN else _NEVER
        self.mark = owner_next_seq, now  # the owner's next seq at an earlier report, and the time of that report
        self.change = 0  # the number of the latest change of the flag

    def is_same(self, known: KnownReplica | None) -> bool:
        """Whether the directory still has this replica, and has not removed it and added it again since."""
        return known is not None and (known.boot_incarnation, known.added_index) == (
            self.boot_incarnation,
            self.added_index,
        )

    def lose_items(self, owner_next_seq: int, now: int) -> None:
        self.next_seq, self.caught_up, self.mark = 0, _NEVER, (owner_next_seq, now)

    @property
    def is_waited_for(self) -> bool:
        return self.state is not ReplicaState.OUT

    def report(self, next_seq: int, owner_next_seq: int, now: int) -> None:
        self.next_seq = next_seq
        mark_seq, mark_time = self.mark
        if next_seq >= owner_next_seq:
            self.caught_up = now
        elif next_seq >= mark_seq:
            self.caught_up = max(self.caught_up, mark_time)
        if next_seq >= mark_seq:
            self.mark = owner_next_seq, now


class ReplicasInSync:
    """The replicas of one channel. `now` is a steady clock in nanoseconds.

    All items before `replicated` are at every replica for which the owner waits, and were at `min_replicas` replicas
    with a flag in the log when `replicated` passed them. The owner acknowledges only these items, and readers see only
    these. `start` is the owner's next seq when it began: the items before it may have been acknowledged by a former
    owner. Such items need no minimum of replicas. `is_replicated`: the former owner has said that all these items are
    replicated. `may_lag`: puts wait only for replicas with a flag that are behind for more than LAG_NANOS_MAX.
    """

    def __init__(self, start: int, min_replicas: int, *, is_replicated: bool = False, may_lag: bool = False) -> None:
        self._lag_nanos_max = EARLY_LAG_NANOS_MAX if may_lag else LAG_NANOS_MAX
        self._may_lag = may_lag
        self.start = start
        self.replicated = start if is_replicated else 1
        self.min_replicas = min_replicas
        self._next_seq = start
        self._replicas: dict[bytes, _Replica] = {}
        self._is_known = False
        self._needs_no_list = is_replicated
        self._last_change = 0

    @property
    def is_known(self) -> bool:
        """Whether the owner knows the directory's replicas."""
        return self._is_known

    @property
    def is_ready(self) -> bool:
        """Whether readers may see the items that the owner had when it began."""
        return (self._is_known or self._needs_no_list) and self.replicated >= self.start

    def own_again(self) -> None:
        """Note that another host was the owner meanwhile. It acknowledged nothing, but may have changed the flags."""
        self.start = self._next_seq
        self._replicas.clear()
        self._is_known = False

    def know(self, replicas: Iterable[KnownReplica], now: int) -> set[bytes]:
        """Take over the replicas that the directory has. Before the first call nothing is replicated.

        Returns the hosts whose replicas the directory has removed or added since the call before; none at first.
        """
        known = {one.host_id: one for one in replicas}
        removed = {host_id for host_id, one in self._replicas.items() if not one.is_same(known.get(host_id))}
        for host_id in removed:
            del self._replicas[host_id]  # the directory never makes such a replica the owner
        added = known.keys() - self._replicas.keys()
        for one in known.values():
            if one.host_id in added:
                self._replicas[one.host_id] = _Replica(one, self._next_seq, now)
            else:
                self._compare_flag(one, now)
        was_known, self._is_known = self._is_known, True
        self._advance_replicated()
        return removed | added if was_known else set()

    def _compare_flag(self, known: KnownReplica, now: int) -> None:
        """Clear the flag if another owner has changed it meanwhile, or if a directory of an earlier release does not
        say that a caller has removed the replica and added it again.
        """
        replica = self._replicas[known.host_id]
        if replica.state is (ReplicaState.OUT if known.in_sync else ReplicaState.IN):
            self._become(replica, ReplicaState.LEAVING, now)

    @property
    def is_fully_replicated(self) -> bool:
        """Whether all replicas for which the owner waits hold all items."""
        return self._is_known and all(one.next_seq >= self._next_seq for one in self._waited_for())

    def within_lag(self, now: int) -> bool:
        """Whether each replica that may become the owner has all items that the owner had LAG_NANOS_MAX ago."""
        return self._is_known and all(now - one.caught_up <= LAG_NANOS_MAX for one in self._waited_for())

    def _waited_for(self) -> list[_Replica]:
        return [one for one in self._replicas.values() if one.is_waited_for]

    def is_out(self, host_id: bytes) -> bool:
        """Whether the replica at this host is known, and has no flag."""
        replica = self._replicas.get(host_id)
        return replica is not None and not replica.is_waited_for

    def states(self) -> dict[bytes, ReplicaState]:
        """The state of each replica, by its host."""
        return {host_id: one.state for host_id, one in self._replicas.items()}

    def put(self, next_seq: int) -> None:
        """Note that the owner has accepted the items before `next_seq`."""
        self._next_seq = next_seq
        self._advance_replicated()

    def report(self, host_id: bytes, next_seq: int, now: int) -> None:
        """Note that a replica holds all items before `next_seq`."""
        replica = self._replicas.get(host_id)
        if replica is not None:
            replica.report(min(next_seq, self._next_seq), self._next_seq, now)
            self._advance_replicated()

    def changes(self, now: int) -> list[ReplicaChange]:
        """The flags that the directory must set or clear now. Repeats a change until `confirm` has come for it."""
        return [change for host_id, one in self._replicas.items() if (change := self._change(host_id, one, now))]

    def _change(self, host_id: bytes, one: _Replica, now: int) -> ReplicaChange | None:
        lags = now - one.caught_up > self._lag_nanos_max
        if one.state in (ReplicaState.IN, ReplicaState.JOINING) and lags:
            self._become(one, ReplicaState.LEAVING, now)
        elif one.state is ReplicaState.OUT and not lags and (self._may_lag or one.next_seq >= self._needed):
            self._become(one, ReplicaState.JOINING, now)
        if one.state in (ReplicaState.JOINING, ReplicaState.LEAVING):
            is_joining = one.state is ReplicaState.JOINING
            return ReplicaChange(host_id, one.boot_incarnation, is_joining, one.change, one.added_index)
        return None

    @property
    def _needed(self) -> int:
        return max(self.replicated, self.start)

    def _become(self, one: _Replica, state: ReplicaState, now: int) -> None:
        one.state = state
        self._last_change = one.change = max(now, self._last_change + 1)

    def confirm(self, change: ReplicaChange) -> None:
        """Note that the log has the change. Ignores the change if there is a newer one."""
        one = self._replicas.get(change.host_id)
        if one is None or (one.boot_incarnation, one.change) != (change.boot_incarnation, change.number):
            return
        if change.in_sync and one.state is ReplicaState.JOINING:
            one.state = ReplicaState.IN
        elif not change.in_sync and one.state is ReplicaState.LEAVING:
            one.state = ReplicaState.OUT
        self._advance_replicated()

    def drop(self, host_id: bytes, now: int) -> bool:
        """Note that the replica loses its items. Returns False, and notes nothing, while the replica may have the flag:
        clear the flag first.
        """
        one = self._replicas.get(host_id)
        if one is None:
            return self._is_known
        if one.state in (ReplicaState.IN, ReplicaState.JOINING):
            self._become(one, ReplicaState.LEAVING, now)
        if one.state is ReplicaState.OUT:
            one.lose_items(self._next_seq, now)
        return one.state is ReplicaState.OUT

    def copies(self, next_seq: int) -> int:
        """The number of hosts that hold all items before `next_seq` and may become the owner, the owner included."""
        return 1 + sum(one.state is ReplicaState.IN and one.next_seq >= next_seq for one in self._replicas.values())

    def _advance_replicated(self) -> None:
        if not self._is_known:
            return
        least, in_sync = self._next_seq, 0
        for one in self._replicas.values():  # each put and each report runs this loop, so it makes no lists
            if one.is_waited_for:
                least = min(least, one.next_seq)
                in_sync += one.state is ReplicaState.IN
        most = least if in_sync >= self.min_replicas else min(least, self.start)
        self.replicated = max(self.replicated, most)
