"""Crashes at each step of a move of a channel with a replica: no crash loses an acknowledged or seen item.

The channel moves to the host of its replica, or to a host without a copy. The code of moves, replicas and feeds is
real, and so is the state machine of the directory.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import suppress

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels import move_under_way
from stampede_rt_channel_host.channels.owned_replicas import ServingPeriod
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.copies import copy_feed, keeper, replica_keeper
from stampede_rt_channel_host.copies.moves import incoming_moves, outgoing_moves
from stampede_rt_supernode.core.records import ReplicaKind
from tests.robustness.moves.links import Link
from tests.robustness.moves.test_crashes_at_each_step import ITEMS, Scenario
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, THIRD, World
from tests.support.supernode.operations import id_of

PLACES = [pytest.param(DESTINATION, id="to the replica"), pytest.param(THIRD, id="to a host without a copy")]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the waits of the product to milliseconds, because the test waits for each step in turn."""
    monkeypatch.setattr(copy_feed, "REQUEST_SECONDS", 0.005)
    monkeypatch.setattr(copy_feed, "REPLICA_REQUEST_SECONDS", 0.005)
    monkeypatch.setattr(outgoing_moves, "RETRY_SECONDS", 0.005)
    monkeypatch.setattr(outgoing_moves, "FALLBACK_SECONDS", 0.005)
    monkeypatch.setattr(incoming_moves, "RETRY_SECONDS_MAX", 0.005)
    monkeypatch.setattr(incoming_moves, "RELEASED_SECONDS_MAX", 0.05)
    monkeypatch.setattr(keeper, "PAUSE_SECONDS_MIN", 0.005)
    monkeypatch.setattr(keeper, "PAUSE_SECONDS_MAX", 0.01)
    monkeypatch.setattr(keeper, "REPLICA_PAUSE_SECONDS_MAX", 0.01)
    monkeypatch.setattr(replica_keeper, "ROUND_SECONDS", 0.01)
    monkeypatch.setattr(replica_keeper, "PAUSE_SECONDS", 0.001)
    monkeypatch.setattr(replica_keeper, "MISSING_SECONDS", 0.02)
    monkeypatch.setattr(replica_keeper, "LIST_SECONDS", 0.05)


class ReplicatedScenario(Scenario):
    """A put is acknowledged when its item is replicated. Readers look at each host between two puts."""

    def __init__(self, replica_at: int, crash_at: str = "", happens: Callable[[World], None] = lambda world: None):
        super().__init__(crash_at, happens, replica_at)
        self.at: dict[int, tuple[Replication, ServingPeriod]] = {}
        self.seen: set[int] = set()

    def put(self) -> None:
        number = self.next
        super().put()
        self.look()
        if self.next > number and (waiting := [host for one, _, host in self.waiting if one == number]):
            hosted = waiting[0].store.known(self.world.channel_id)
            assert hosted is not None
            assert hosted.replication is not None
            self.at[number] = hosted.replication, hosted.replication.period

    def look(self) -> None:
        """Note the items that readers see now."""
        for host in self.world.hosts.values():
            try:
                hosted = host.store.find(self.world.channel_id, self.world.record.epoch)
            except StampedeError:
                continue
            self.seen |= {*host.items(hosted)}

    def note_acks(self) -> None:
        for each in [*self.waiting]:
            number, run, host = each
            replication, period = self.at.get(number, (None, None))
            if not host.alive or (run.ack is not None and run.ack.HasField("error")):
                self.waiting.remove(each)
            elif run.ack is not None and replication is not None and period is not None:
                if replication.replicated_next > run.ack.first_seq:
                    self.acknowledged.append(number)
                    self.waiting.remove(each)
                elif period.ended is not None:
                    self.waiting.remove(each)  # the producer tries again

    def in_sync(self) -> dict[bytes, ReplicaKind]:
        copies = self.world.log.directory.tables.replicas.of(self.world.channel_id)
        return {one.host_id: one.kind for one in copies if one.in_sync}

    async def begin(self) -> None:
        """Wait until the replica is in sync, and put until ITEMS items are acknowledged."""
        await self.source.store.bind_for_feed(self.world.channel_id, 1)
        await self.until(lambda: len(self.in_sync()) == 1)
        while len(self.acknowledged) < ITEMS:
            self.put()
            await asyncio.sleep(0)

    async def move(self) -> StampedeError | None:
        await self.begin()
        self.world.allow(DESTINATION)
        move = asyncio.create_task(self.destination.incoming.move_here(*self.world.placed()))
        while not move.done():
            self.put()
            await asyncio.sleep(0)
        self.put()
        failure = None if move.cancelled() else move.exception()
        assert failure is None or isinstance(failure, StampedeError), failure
        return failure

    async def finish(self) -> None:
        """Check that puts go on, and that the owner has every acknowledged or seen item at the end."""
        count = len(self.acknowledged)
        async with asyncio.timeout(30):
            while len(self.acknowledged) < count + ITEMS:
                with suppress(StampedeError):
                    await self.world.owner.store.bind(self.world.channel_id, self.world.record.epoch)
                self.put()
                await asyncio.sleep(0.001)
        items = await self.settle()
        self.look()
        self.check(items)
        assert self.seen <= {*items}


@pytest.fixture
async def scenarios() -> AsyncIterator[list[ReplicatedScenario]]:
    made: list[ReplicatedScenario] = []
    yield made
    for one in made:
        await one.world.aclose()


@pytest.mark.parametrize("replica_at", PLACES)
async def test_a_move_keeps_the_replica_or_puts_the_former_owner_in_its_place(
    scenarios: list[ReplicatedScenario], replica_at: int
) -> None:
    scenario = ReplicatedScenario(replica_at)
    scenarios.append(scenario)
    assert await scenario.move() is None
    assert scenario.world.owner is scenario.destination
    place = SOURCE if replica_at == DESTINATION else THIRD
    assert scenario.in_sync() == {id_of(place): ReplicaKind.WARM}
    await scenario.finish()
    assert scenario.in_sync() == {id_of(place): ReplicaKind.WARM}
    if place == SOURCE:
        copy = scenario.source.store.copies.of(scenario.world.channel_id)
        assert copy is not None
        assert copy.channel.next_seq >= ITEMS
    else:
        await scenario.until(lambda: scenario.source.store.known(scenario.world.channel_id) is None)


@pytest.mark.parametrize("victim", [SOURCE, DESTINATION, THIRD])
@pytest.mark.parametrize("replica_at", PLACES)
@pytest.mark.parametrize("step", STEPS)
async def test_a_move_with_replicas_loses_nothing_if_a_host_dies(
    scenarios: list[ReplicatedScenario], step: str, replica_at: int, victim: int
) -> None:
    scenario = ReplicatedScenario(replica_at, step, lambda world: world.kill(victim))
    scenarios.append(scenario)
    await scenario.move()
    scenario.world.expire(victim)
    await scenario.finish()


@pytest.mark.parametrize("replica_at", PLACES)
@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_link_between_the_hosts_breaks(
    scenarios: list[ReplicatedScenario], step: str, replica_at: int
) -> None:
    scenario = ReplicatedScenario(replica_at, step, lambda world: world.cut_links())
    scenarios.append(scenario)
    await scenario.move()
    await scenario.finish()


@pytest.mark.parametrize("replica_at", PLACES)
@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_directory_cannot_be_reached_for_a_while(
    scenarios: list[ReplicatedScenario], step: str, replica_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The directory cannot be reached for longer than a change waits. So the source ends the move when it reaches the
    directory again.
    """
    for module in (move_under_way, outgoing_moves):
        monkeypatch.setattr(module, "HELD_SECONDS_MAX", 0.05)

    def cut_off(world: World) -> None:
        world.is_cut_off = True
        asyncio.get_running_loop().call_later(0.15, setattr, world, "is_cut_off", False)

    scenario = ReplicatedScenario(replica_at, step, cut_off)
    scenarios.append(scenario)
    await scenario.move()
    await scenario.finish()


async def test_an_owner_that_renews_its_lease_late_finds_another_replica_and_acknowledges_puts(
    scenarios: list[ReplicatedScenario],
) -> None:
    """The lease has run out only by the owner's own clock, so the host is the owner all the time, and does not register
    again.
    """
    scenario = ReplicatedScenario(DESTINATION)
    scenarios.append(scenario)
    await scenario.begin()
    scenario.source.has_lease = False
    scenario.source.store.fence()
    scenario.put()
    scenario.source.has_lease = True
    scenario.world.kill(DESTINATION)
    scenario.world.expire(DESTINATION)
    await scenario.finish()
    assert scenario.world.owner is scenario.source
    assert scenario.in_sync() == {id_of(THIRD): ReplicaKind.WARM}


@pytest.mark.parametrize("replica_at", PLACES)
async def test_the_new_owner_dies_immediately_and_its_replica_becomes_the_owner(
    scenarios: list[ReplicatedScenario], replica_at: int
) -> None:
    """After a move to the host of the replica, the former owner is the replica. Otherwise the replica stays."""
    scenario = ReplicatedScenario(replica_at)
    scenarios.append(scenario)
    assert await scenario.move() is None
    scenario.put()
    scenario.world.kill(DESTINATION)
    scenario.world.expire(DESTINATION)
    assert scenario.world.owner is scenario.world.hosts[SOURCE if replica_at == DESTINATION else THIRD]
    await scenario.finish()


@pytest.mark.parametrize(
    ("owner_epoch", "ahead", "begins_anew"),
    [(1, 0, False), (1, 1, True), (0, -1, True), (2, 1, False)],
    ids=["with nothing else", "with an item that the owner lacks", "from two owners ago", "with items of this owner"],
)
async def test_a_replica_begins_anew_if_it_may_have_items_of_a_former_owner_that_the_owner_lacks(
    scenarios: list[ReplicatedScenario], owner_epoch: int, ahead: int, begins_anew: bool
) -> None:
    """Meanwhile the owner has accepted other items with the same seqs, so the seqs alone do not show the difference."""
    scenario = ReplicatedScenario(DESTINATION)
    scenarios.append(scenario)
    await scenario.begin()
    for number in (SOURCE, THIRD):  # the test makes the requests of the third host
        scenario.world.kill(number)
    scenario.world.expire(SOURCE)
    hosted = await scenario.destination.store.bind_for_feed(scenario.world.channel_id, 2)
    replication = hosted.replication
    assert replication is not None
    await scenario.until(lambda: replication.is_known and replication.is_ready)
    for _ in range(3):
        scenario.put()
    assert hosted.core.next_seq > replication.start + 1
    link = Link(scenario.world, scenario.destination)
    place = pb.FeedPlace(
        incarnation=scenario.world.incarnation, next_seq=replication.start + ahead, owner_epoch=owner_epoch
    )  # fmt: skip
    opening = pb.FeedOpen(
        channel_id=scenario.world.channel_id, epoch=2, host_id=id_of(THIRD), target="third:1", place=place,
        owner_facts=True,
    )  # fmt: skip
    await link.write(pb.FeedRequest(open=opening, credit_bytes=10**6))
    async with asyncio.timeout(10):
        assert (await link.read()).fields.opened.begins_anew is begins_anew
    link.cut()
