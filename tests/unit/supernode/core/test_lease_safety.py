"""No lease is ended while its host may still serve, whatever is delayed, lost, overtaken or replaced.

One host, two supernodes that lead in turn, one clock. The host sends messages to the leader, which acknowledges them.
It serves until 0.8 TTL after it sent the last acknowledged message. Messages and proposals wait in flight for as long
as hypothesis likes, and take effect in any order.
"""

from __future__ import annotations

import os

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from stampede_rt_supernode.core.hosts.commands import ExpireHost, HostExpired
from stampede_rt_supernode.core.lease import LeaseTable
from stampede_rt_supernode.core.records import HostRecord
from tests.support.supernode.operations import Log, begin_tenure, id_of, register

SECOND = 10**9
TTL = 5 * SECOND
HOST_ID = id_of(1)
delays = st.sampled_from([0, 0, 0, 3])


class LeaseMachine(RuleBasedStateMachine):
    """`confirming`: renewals that wait for their read to be confirmed, as (node, tenure, received, sent). `endings`:
    proposals under way."""

    @initialize()
    def found(self) -> None:
        self.log = Log(founded=False)
        self.now = 100 * SECOND
        self.tables = [LeaseTable(), LeaseTable()]
        self.leader, self.tenure = 0, 1
        self.confirming: list[tuple[int, int, int, int]] = []
        self.endings: list[ExpireHost] = []
        self.fenced_at = 0
        self.take_over()
        self.register(0)

    def live(self) -> list[HostRecord]:
        return list(self.log.directory.tables.live_hosts())

    def acknowledged(self, sent: int) -> None:
        self.fenced_at = max(self.fenced_at, sent + TTL * 4 // 5)

    @rule(seconds=st.integers(1, 6), looking=st.sampled_from([(0,), (1,), (0, 1), (0, 1)]), sees_log=st.booleans())
    def pass_time(self, seconds: int, looking: tuple[int, ...], sees_log: bool) -> None:
        """Let time pass. A leader that does not look is frozen."""
        for _ in range(seconds):
            self.now += SECOND
            for node in looking:
                self.look(node, sees_log)

    def look(self, node: int, sees_log: bool) -> None:
        table = self.tables[node]
        if sees_log:
            table.follow(self.live(), self.now)
        for host_id, boot, registered_index in table.due(self.now):
            ending = ExpireHost(
                host_id=host_id, boot_incarnation=boot, registered_index=registered_index, tenure=table.tenure
            )
            if ending not in self.endings:
                self.endings.append(ending)

    @rule(delay=delays, also_live=st.sampled_from([False, False, True]))
    def register(self, delay: int, also_live: bool = True) -> None:
        """A registration that was sent a while ago takes effect."""
        if self.live() and not also_live:
            return
        self.log.apply(register(1))
        self.acknowledged(self.now - delay * SECOND)

    @rule(delay=delays)
    def renew_immediately(self, delay: int) -> None:
        self.receive_renewal(self.leader, delay)
        if self.confirming:
            self.confirm_renewal(len(self.confirming) - 1)

    @rule(node=st.integers(0, 1), delay=delays)
    def receive_renewal(self, node: int, delay: int) -> None:
        if self.tables[node].tenure:
            self.confirming.append((node, self.tables[node].tenure, self.now, self.now - delay * SECOND))

    @precondition(lambda self: self.confirming)
    @rule(which=st.just(0))
    def confirm_renewal(self, which: int) -> None:
        """Confirm a renewal, as LeaseKeeper.renew does. Only the leader can confirm a read."""
        node, tenure, received, sent = self.confirming.pop(which % len(self.confirming))
        table, host = self.tables[node], self.log.directory.tables.hosts.get(HOST_ID)
        leads = node == self.leader and table.tenure == tenure == self.tenure
        if leads and host is not None and host.alive and table.renew(host, received):
            self.acknowledged(sent)

    @rule(takes_over=st.booleans())
    def elect_the_other(self, takes_over: bool) -> None:
        """The other supernode begins to lead. The former leader does not learn of it here."""
        self.leader, self.tenure = 1 - self.leader, self.tenure + 1
        if takes_over:
            self.take_over()

    @rule()
    def take_over(self) -> None:
        table = self.tables[self.leader]
        if table.tenure != self.tenure:
            self.log.apply(begin_tenure(self.tenure))
            table.lead(self.tenure, self.live(), self.now, ttl_nanos=TTL)

    @precondition(lambda self: self.endings)
    @rule(which=st.integers(0, 9))
    def end(self, which: int) -> None:
        result = self.log.apply(self.endings.pop(which % len(self.endings)))
        if result == HostExpired(expired=True):
            assert self.now >= self.fenced_at, "the host may still serve"


TestLeases = LeaseMachine.TestCase
TestLeases.settings = settings(
    max_examples=int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "300")), stateful_step_count=30
)
