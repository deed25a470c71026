"""Nothing leaves the owner of a queue before its replicas know of it."""

from __future__ import annotations

import asyncio

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.core.replication import KnownReplica
from stampede_rt_channel_host.queues.queue_replication import STALLED_NANOS, QueueReplication
from tests.support.channel_host.queue_cores import Core

REPLICA = b"r" * 16


class Feed:
    """The feed of a replica that has everything that was sent."""

    next_step = 1
    woken = 0

    def wake(self) -> None:
        self.woken += 1


class Owner:
    """A queue with one replica in sync, unless `in_sync` is False."""

    def __init__(self, *, min_replicas: int | None = None, in_sync: bool = True) -> None:
        self.clock = 0
        self.core = Core()
        policy = QueuePolicy(replicas=1, ack="replica", min_replicas=min_replicas)
        journal = self.core.queue.journal()
        self.replication = QueueReplication(journal, policy, 1, is_replicated=True, steady_nanos=lambda: self.clock)
        self.feed = Feed()
        self.replication.add(REPLICA, self.feed)
        self.replication.know([KnownReplica(REPLICA, 1, in_sync)])
        self.replication.report(REPLICA, self.feed, 1)
        self.done: list[str] = []

    def put(self, name: str) -> None:
        self.core.put(1)
        self.replication.changed(self.core.now)
        self.replication.once_replicated(name, lambda: self.done.append(name))

    def report(self, next_step: int) -> None:
        self.replication.report(REPLICA, self.feed, next_step)


def test_actions_wait_for_the_replica_and_keep_their_order() -> None:
    owner = Owner()
    owner.put("one")
    owner.put("two")
    assert (owner.done, owner.feed.woken, owner.replication.is_level) == ([], 2, False)
    owner.report(2)
    assert (owner.done, owner.replication.copies(2), owner.replication.copies(3)) == (["one"], 2, 1)
    owner.report(3)
    assert (owner.done, owner.replication.is_level) == (["one", "two"], True)
    owner.replication.once_replicated(None, lambda: owner.done.append("now"))
    assert owner.done[-1] == "now"


def test_a_forgotten_action_is_never_performed() -> None:
    owner = Owner()
    owner.put("one")
    owner.put("two")
    assert owner.replication.forget("one")
    assert not owner.replication.forget("one")
    owner.report(3)
    assert owner.done == ["two"]


def test_a_queue_without_enough_replicas_delivers_nothing_and_stalls() -> None:
    owner = Owner(in_sync=False)
    owner.put("one")
    owner.report(2)
    owner.clock += STALLED_NANOS
    assert (owner.done, owner.replication.is_stalled) == ([], False)
    owner.clock += 1
    assert owner.replication.is_stalled
    for change in owner.replication.changes():
        owner.replication.confirm(change)
    assert owner.done == []  # it was silent for more than a second, and joins only with its next report
    owner.report(2)
    for change in owner.replication.changes():
        owner.replication.confirm(change)
    assert (owner.done, owner.replication.is_stalled) == (["one"], False)


def test_an_owner_without_a_minimum_continues_without_replicas() -> None:
    owner = Owner(min_replicas=0, in_sync=False)
    owner.put("one")
    assert owner.done == ["one"]


def test_steps_that_every_replica_has_are_forgotten_and_those_of_a_slow_feed_are_kept() -> None:
    owner = Owner()
    owner.put("one")
    owner.feed.next_step = 2
    owner.report(2)
    assert owner.replication.journal.size_bytes == 0
    owner.put("two")
    owner.report(3)
    assert owner.replication.journal.steps_from(2, 10**9) is not None


async def test_a_wait_ends_with_the_replicas_with_its_time_or_with_the_queue() -> None:
    owner = Owner()
    owner.put("one")
    assert not await owner.replication.replicated(2, 0.001)
    owner.report(2)
    assert await owner.replication.replicated(2, None)
    owner.put("two")
    waiting = asyncio.create_task(owner.replication.replicated(3, None))
    await asyncio.sleep(0)
    owner.replication.end(Unavailable("the host gives the queue up"))
    assert not await waiting
    owner.report(3)
    assert (await owner.replication.replicated(3, None), owner.done) == (True, ["one"])


@pytest.mark.parametrize("waits", [True, False])
def test_a_released_queue_answers_everything(waits: bool) -> None:
    owner = Owner()
    if waits:
        owner.put("one")
    owner.replication.release()
    assert owner.done == (["one"] if waits else [])
    assert owner.replication.journal.size_bytes == 0


def test_the_status_shows_the_position_of_a_replica() -> None:
    owner = Owner()
    owner.put("one")
    owner.clock += 30
    (status,) = owner.replication.statuses()
    assert (status.host_id, status.waiting, status.in_sync, status.replica) == (REPLICA, 1, True, True)
    assert status.heard_ago_nanos == 30
