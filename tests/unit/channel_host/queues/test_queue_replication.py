"""Nothing leaves the owner of a queue before its replicas know of it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue import AheadPut
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.core.replication import KnownReplica
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_replication import STALLED_NANOS, QueueReplication
from tests.support.channel_host.queue_cores import Core

REPLICA = b"r" * 16


class Feed:
    """The feed of a replica that has everything that was sent."""

    next_step = 1
    woken = 0

    def wake(self) -> None:
        self.woken += 1

    def send_ahead(self, put: AheadPut) -> None:
        raise AssertionError("the queue puts no message ahead")

    def end(self, error: StampedeError) -> None:
        pass

    def take_back(self) -> None:
        raise AssertionError("the queue puts no message ahead")


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
    assert (owner.done, owner.feed.woken, owner.replication.is_fully_replicated) == ([], 2, False)
    owner.report(2)
    assert (owner.done, owner.replication.copies(2), owner.replication.copies(3)) == (["one"], 2, 1)
    owner.report(3)
    assert (owner.done, owner.replication.is_fully_replicated) == (["one", "two"], True)
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
    assert [*owner.replication.changes()] == []  # the silent replica joins only with its next report
    assert owner.done == []
    owner.report(2)
    for change in owner.replication.changes():
        owner.replication.confirm(change)
    assert (owner.done, owner.replication.is_stalled) == (["one"], False)


def test_an_owner_without_a_minimum_continues_without_replicas() -> None:
    owner = Owner(min_replicas=0, in_sync=False)
    owner.put("one")
    assert owner.done == ["one"]


def test_an_owner_deletes_the_steps_that_every_replica_has_and_keeps_the_steps_that_a_slow_feed_lacks() -> None:
    owner = Owner()
    owner.put("one")
    owner.feed.next_step = 2
    owner.report(2)
    assert owner.replication.journal.size_bytes == 0
    owner.put("two")
    owner.report(3)
    assert owner.replication.journal.steps_from(2, 10**9) is not None


async def test_a_wait_ends_when_the_replicas_have_the_step_or_at_its_timeout_or_with_the_queue() -> None:
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
def test_a_released_queue_answers_all_waiting_calls(waits: bool) -> None:
    owner = Owner()
    if waits:
        owner.put("one")
    owner.replication.release()
    assert owner.done == (["one"] if waits else [])


def test_the_status_shows_the_position_of_a_replica() -> None:
    owner = Owner()
    owner.put("one")
    owner.clock += 30
    (status,) = owner.replication.statuses()
    assert (status.host_id, status.waiting, status.in_sync, status.replica) == (REPLICA, 1, True, True)
    assert status.heard_ago_nanos == 30


def test_a_host_that_owns_a_queue_again_waits_for_new_reports_of_its_replicas() -> None:
    owner = Owner()
    owner.put("one")
    owner.report(2)
    owner.replication.own_again(3)
    assert (owner.replication.since_epoch, owner.replication.start, owner.replication.is_known) == (3, 2, False)
    owner.put("two")
    owner.report(3)
    assert owner.done == ["one"], "the owner does not know which replicas the directory has"
    owner.replication.know([KnownReplica(REPLICA, 1, True)])
    assert owner.done == ["one"]
    owner.report(3)
    assert owner.done == ["one", "two"]


async def test_only_a_queue_that_has_really_moved_is_owned_since_a_new_epoch() -> None:
    for epoch, since_epoch in ((2, 1), (3, 3)):
        hosted = await held_queue()
        assert hosted.replication is not None
        hosted.update(replace(hosted.record, epoch=epoch))
        assert hosted.moving is None
        assert (hosted.epoch, hosted.replication.since_epoch) == (epoch, since_epoch)


async def held_queue() -> HostedQueue:
    """A queue with replicas, at epoch 1, which is about to move."""
    record = RecordedQueue(
        queue_id=b"q" * 16, name="jobs", host_id=b"h" * 16, epoch=1, incarnation=5, spec_version=1,
        policy=QueuePolicy(replicas=1, ack="replica"), message=b"",
    )  # fmt: skip
    hosted = HostedQueue(record, MemoryBudget(2**20), lambda: 0, lambda hosted: None, Deadlines())
    await hosted.hold(Unavailable("the queue moves"))
    return hosted
