"""A replica that the log calls in sync holds all replicated items, whatever the replicas and the log do."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stampede_rt_channel_host.core.replication import (
    EARLY_LAG_NANOS_MAX,
    LAG_NANOS_MAX,
    KnownReplica,
    ReplicaChange,
    ReplicasInSync,
    ReplicaState,
)
from tests.property.random_source import RandomSource

EXAMPLES = int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "1000"))
HOSTS = (b"a", b"b", b"c")


@dataclass
class Host:
    """A replica's host: the items that it holds, and its state in the directory's log."""

    holds: int = 0
    boot: int = 1
    is_listed: bool = True
    has_flag: bool = False
    last_change: int = 0
    added_index: int = 1


@dataclass
class Model:
    """An owner, its replicas, and the log. Requests to the log may come late, and answers may be lost."""

    min_replicas: int
    start: int
    clock: int = 10**12
    next_seq: int = field(init=False)
    hosts: dict[bytes, Host] = field(default_factory=lambda: {one: Host() for one in HOSTS})
    under_way: list[ReplicaChange] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.next_seq = self.start
        for host in self.hosts.values():  # a former owner has acknowledged the items before `start`
            host.holds = self.start
        self.hosts[b"a"].has_flag = self.start > 1
        self.owner = ReplicasInSync(self.start, self.min_replicas)

    def know(self) -> None:
        listed = [
            KnownReplica(one, host.boot, host.has_flag, host.added_index)
            for one, host in self.hosts.items()
            if host.is_listed
        ]
        self.owner.know(listed, self.clock)

    def apply(self, change: ReplicaChange) -> bool:
        """Apply the change to the log, unless it comes too late. Returns True if the log has it now."""
        host = self.hosts[change.host_id]
        is_present = (host.boot, host.added_index) == (change.boot_incarnation, change.added_index)
        if not host.is_listed or not is_present or change.number < host.last_change:
            return False
        host.has_flag, host.last_change = change.in_sync, change.number
        return True

    def step(self, rng: RandomSource) -> None:
        host_id, before = rng.pick(HOSTS), self.owner.replicated
        host, kind = self.hosts[host_id], rng.below(9)
        if kind == 0:
            self.next_seq += 1 + rng.below(3)
            self.owner.put(self.next_seq)
        elif kind == 1:
            host.holds = max(host.holds, min(self.next_seq, host.holds + rng.below(4)))
            self.owner.report(host_id, max(0, host.holds - rng.below(2)), self.clock)
        elif kind == 2:
            self.clock += rng.pick((1, LAG_NANOS_MAX // 2, LAG_NANOS_MAX + 1))
        elif kind == 3:
            self.under_way += self.owner.changes(self.clock)
        elif kind == 4 and self.under_way:
            change = self.under_way.pop(rng.below(len(self.under_way)))
            if self.apply(change) and not rng.one_in(3):
                self.owner.confirm(change)
        elif kind == 5 and self.owner.drop(host_id, self.clock):
            host.holds = 0
        elif kind == 6 and rng.one_in(3):  # the host restarts
            host.boot, host.holds, host.has_flag, host.last_change = host.boot + 1, 0, False, 0
        elif kind == 7:  # a caller removes the replica, and the host drops its items; or adds it (again)
            host.is_listed = not host.is_listed or rng.one_in(2)
            host.has_flag, host.last_change, host.holds = False, 0, 0
            host.added_index += host.is_listed
        self.know()
        self.check(before)

    def check(self, before: int) -> None:
        replicated, flagged = self.owner.replicated, [one for one in self.hosts.values() if one.has_flag]
        assert before <= replicated <= self.next_seq
        assert all(one.holds >= replicated for one in flagged)
        if replicated > max(before, self.start):
            assert len(flagged) >= self.min_replicas

    def settle(self) -> None:
        """Let all replicas run and hold everything, lose no message, and check that all are in sync."""
        for _ in range(3):
            for host_id, host in self.hosts.items():
                host.is_listed, host.holds = True, self.next_seq
                self.know()
                self.owner.report(host_id, host.holds, self.clock)
            for change in self.owner.changes(self.clock):
                assert self.apply(change)
                self.owner.confirm(change)
        assert self.owner.replicated == self.next_seq
        assert set(self.owner.states().values()) == {ReplicaState.IN}
        assert self.owner.copies(self.next_seq) == 1 + len(HOSTS)


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**64), min_size=4, max_size=60))
def test_every_replica_with_the_flag_holds_all_replicated_items(numbers: list[int]) -> None:
    first = RandomSource(numbers[0])
    model = Model(min_replicas=first.below(3), start=first.pick((1, 5)))
    for number in numbers[1:]:
        model.step(RandomSource(number))
    model.settle()


@dataclass
class LaggingModel(Model):
    """Like `Model`, but with puts that do not wait for the replicas."""

    accepted: dict[int, int] = field(default_factory=dict)  # the time of each item's acceptance, by seq
    acknowledged_at: int = -(2**62)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.owner = ReplicasInSync(self.start, self.min_replicas, may_lag=True)

    def step(self, rng: RandomSource) -> None:
        first = self.next_seq
        super().step(rng)
        self.accepted |= dict.fromkeys(range(first, self.next_seq), self.clock)
        delisted = {host_id for host_id, host in self.hosts.items() if not host.is_listed}
        # If the log lists such a host again, its entry counts as another replica.
        self.under_way = [one for one in self.under_way if one.host_id not in delisted]
        if self.owner.within_lag(self.clock):
            self.acknowledged_at = self.clock
        self.check_loss()

    def check(self, before: int) -> None:
        assert before <= self.owner.replicated <= self.next_seq

    def check_loss(self) -> None:
        """Check that a host that becomes the owner now has all items accepted long before the last acknowledgement."""
        old = [seq for seq, at in self.accepted.items() if at < self.acknowledged_at - LAG_NANOS_MAX]
        assert all(one.holds > max(old, default=0) for one in self.hosts.values() if one.has_flag)


@pytest.mark.timeout(0 if EXAMPLES > 5000 else 240)
@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), database=None)
@given(st.lists(st.integers(0, 2**64), min_size=4, max_size=60))
def test_no_acknowledged_item_older_than_the_lag_is_lost_with_replicas_that_may_lag(numbers: list[int]) -> None:
    first = RandomSource(numbers[0])
    model = LaggingModel(min_replicas=first.below(3), start=first.pick((1, 5)))
    for number in numbers[1:]:
        model.step(RandomSource(number))
    model.settle()


def test_a_put_waits_for_a_lagging_replica_only_until_the_log_has_cleared_its_flag() -> None:
    owner = ReplicasInSync(1, 1, may_lag=True)
    owner.know([KnownReplica(b"a", 1, in_sync=False)], 0)
    assert owner.within_lag(0)  # no replica may become the owner, so the puts wait for none
    assert owner.changes(0) == []  # the replica has not reported its items yet
    owner.report(b"a", 1, 0)
    for change in owner.changes(0):
        owner.confirm(change)
    owner.put(2)
    assert owner.within_lag(LAG_NANOS_MAX)
    assert owner.changes(EARLY_LAG_NANOS_MAX) == []
    (change,) = owner.changes(EARLY_LAG_NANOS_MAX + 1)
    assert not owner.within_lag(LAG_NANOS_MAX + 1)
    owner.confirm(change)
    assert owner.within_lag(LAG_NANOS_MAX + 1)


def a_pair(min_replicas: int = 1) -> ReplicasInSync:
    """One replica in sync, and one item under way."""
    owner = ReplicasInSync(1, min_replicas)
    owner.know([KnownReplica(b"a", 1, in_sync=False)], 0)
    owner.report(b"a", 1, 0)
    for change in owner.changes(0):
        owner.confirm(change)
    owner.put(2)
    return owner


def test_the_owner_waits_for_a_silent_replica_until_the_log_has_cleared_its_flag() -> None:
    owner = a_pair(min_replicas=0)
    assert owner.changes(LAG_NANOS_MAX) == []
    (change,) = owner.changes(LAG_NANOS_MAX + 1)
    assert not change.in_sync
    assert owner.replicated == 1
    owner.confirm(change)
    assert owner.replicated == 2


def test_nothing_counts_as_replicated_without_the_minimum_of_replicas() -> None:
    owner = a_pair()
    for change in owner.changes(LAG_NANOS_MAX + 1):
        owner.confirm(change)
    assert owner.replicated == 1


def test_a_replica_that_follows_a_steady_stream_stays_in_sync_though_it_is_never_at_the_end() -> None:
    owner = a_pair()
    for at in range(2, 50):
        owner.put(at + 1)
        owner.report(b"a", at, at * LAG_NANOS_MAX // 10)
        assert owner.changes(at * LAG_NANOS_MAX // 10) == []
