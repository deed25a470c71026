"""At each step of a move a host dies, the link breaks, or the directory cannot be reached.

Afterwards the channel has one owner, and no acknowledged item is lost. Both hosts run the real code of moves, over the
real state machine of the directory.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from stampede_rt.errors import MoveConflict, StampedeError
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels import move_under_way
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.new_channels import NewCopy
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.copies import copy_feed, feed_stream, feed_writer
from stampede_rt_channel_host.copies.moves import incoming_moves, move_slots, outgoing_moves
from stampede_rt_channel_host.core.channel import Losses, run_to_end
from stampede_rt_channel_host.metrics import catalog
from stampede_rt_channel_host.metrics.channel_metrics import ChannelMetrics
from stampede_rt_supernode.core.moves.commands import CommitMove
from tests.robustness.moves.links import Link
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, THIRD, Host, World
from tests.support.supernode.operations import id_of

ITEMS = 20
WAITING_MAX = 8  # with this number of waiting puts, the producer puts no more
AFTER_THE_COMMIT = STEPS.index("committed")
AFTER_THE_REMOVAL = STEPS.index("removed")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorten the waits of the product to milliseconds, because the test waits for each step in turn."""
    monkeypatch.setattr(copy_feed, "REQUEST_SECONDS", 0.005)
    monkeypatch.setattr(outgoing_moves, "RETRY_SECONDS", 0.005)
    monkeypatch.setattr(outgoing_moves, "FALLBACK_SECONDS", 0.005)
    monkeypatch.setattr(incoming_moves, "RETRY_SECONDS_MAX", 0.005)
    monkeypatch.setattr(incoming_moves, "RELEASED_SECONDS_MAX", 0.05)


class Scenario:
    """A channel with acknowledged items at the source, a move, and puts that go on."""

    def __init__(
        self, crash_at: str = "", happens: Callable[[World], None] = lambda world: None, replica_at: int = 0, *,
        third: bool = False, world: World | None = None, channel_id: bytes = b"",
    ) -> None:  # fmt: skip
        """`world`, `channel_id`: given by a scenario with several channels."""
        self.world = world or World(crash_at, happens, replica_at, third=third)
        self.channel_id = channel_id or self.world.channel_id
        self.source, self.destination = self.world.hosts[SOURCE], self.world.hosts[DESTINATION]
        self.acknowledged: list[int] = []
        self.waiting: list[tuple[int, IncomingRun, Host]] = []
        self.next = 1

    def put(self) -> None:
        """Put the next item at the host that serves the channel, if there is one and few puts wait."""
        self.note_acks()
        if len(self.waiting) >= WAITING_MAX:
            return
        for host in self.world.hosts.values():
            run = host.put(self.next, self.channel_id) if host.alive else None
            if run is not None:
                self.waiting.append((self.next, run, host))
                self.next += 1
                break
        self.note_acks()

    def note_acks(self) -> None:
        for each in [*self.waiting]:
            number, run, host = each
            if run.ack is not None or not host.alive:  # the caller of a dead host gets an error
                self.waiting.remove(each)
            if run.ack is not None and not run.ack.HasField("error"):
                self.acknowledged.append(number)

    async def move(self, *, is_of_drain: bool = False) -> StampedeError | None:
        """Move the channel, with a put in each turn of the loop. Returns the error of a move that failed."""
        await self.source.store.bind(self.channel_id, 1)
        for _ in range(ITEMS):
            self.put()
        assert len(self.acknowledged) == ITEMS
        self.world.allow(DESTINATION, channel_id=self.channel_id)
        placed = self.world.placed(self.channel_id)
        move = asyncio.create_task(self.destination.incoming.move_here(*placed, is_of_drain=is_of_drain))
        while not move.done():
            self.put()
            await asyncio.sleep(0)
        self.put()
        failure = None if move.cancelled() else move.exception()
        assert failure is None or isinstance(failure, StampedeError), failure
        return failure

    async def settle(self) -> list[int]:
        """Wait until no put waits, and return the items at the owner."""
        async with asyncio.timeout(30):
            while True:
                owner = self.world.owner_of(self.channel_id)
                try:
                    hosted = await owner.store.bind(self.channel_id, self.world.record_of(self.channel_id).epoch)
                    if hosted.moving is None and not self.waiting:
                        return owner.items(hosted)
                except StampedeError:
                    pass
                self.note_acks()
                await asyncio.sleep(0.001)

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until the condition is true, while the background work of the hosts goes on."""
        async with asyncio.timeout(30):
            while True:
                if condition():
                    return
                await asyncio.sleep(0.001)

    def check(self, items: list[int]) -> None:
        """Check that no acknowledged item is lost, no item is there twice, and one host serves the channel."""
        assert set(self.acknowledged) <= set(items)
        assert len(set(items)) == len(items)
        assert self.world.record_of(self.channel_id).incarnation == self.world.incarnation
        serving = 0
        for host in self.world.hosts.values():
            try:
                host.store.find(self.channel_id, self.world.record_of(self.channel_id).epoch)
                serving += 1
            except StampedeError:
                pass
        assert serving == 1


async def test_a_move_goes_through_all_steps_and_loses_nothing() -> None:
    scenario = Scenario()
    assert await scenario.move() is None
    assert set(scenario.world.reached) == set(STEPS)
    scenario.check(await scenario.settle())
    assert scenario.world.owner is scenario.destination
    await scenario.until(lambda: scenario.source.store.known(scenario.world.channel_id) is None)


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_destination_dies(step: str) -> None:
    scenario = Scenario(step, lambda world: world.kill(DESTINATION))
    await scenario.move()
    scenario.world.expire(DESTINATION)
    if STEPS.index(step) >= AFTER_THE_REMOVAL:  # from then on only the destination has the items, like any owner
        assert scenario.world.owner is scenario.destination
        return
    assert scenario.world.owner is scenario.source
    scenario.check(await scenario.settle())


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_source_dies(step: str) -> None:
    scenario = Scenario(step, lambda world: world.kill(SOURCE))
    await scenario.move()
    scenario.world.expire(SOURCE)
    if scenario.world.owner is scenario.destination:
        scenario.check(await scenario.settle())
        assert STEPS.index(step) >= STEPS.index("handed over")
    else:
        assert STEPS.index(step) < AFTER_THE_COMMIT


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_link_between_the_hosts_breaks(step: str) -> None:
    scenario = Scenario(step, lambda world: world.cut_links())
    await scenario.move()
    items = await scenario.settle()
    scenario.check(items)
    scenario.put()
    scenario.check(await scenario.settle())


@pytest.mark.parametrize("step", STEPS)
async def test_a_move_loses_nothing_if_the_directory_cannot_be_reached_for_a_while(
    step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The directory cannot be reached for longer than a change waits. So the source ends the move when it reaches the
    directory again.
    """
    for module in (move_under_way, outgoing_moves):
        monkeypatch.setattr(module, "HELD_SECONDS_MAX", 0.05)

    def cut_off(world: World) -> None:
        world.is_cut_off = True
        asyncio.get_running_loop().call_later(0.15, setattr, world, "is_cut_off", False)

    scenario = Scenario(step, cut_off)
    await scenario.move()
    scenario.check(await scenario.settle())


@pytest.mark.parametrize("step", ["handed over", "removal is asked for"])
async def test_every_put_gets_an_answer_while_the_directory_cannot_be_reached_for_long(
    step: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The source answers before the commit, and the destination after it. Puts that come later get answers, too."""
    for module in (move_under_way, outgoing_moves):
        monkeypatch.setattr(module, "HELD_SECONDS_MAX", 0.02)
    scenario = Scenario(step, lambda world: setattr(world, "is_cut_off", True))
    await scenario.source.store.bind(scenario.world.channel_id, 1)
    scenario.world.allow(DESTINATION)
    move = asyncio.create_task(scenario.destination.incoming.move_here(*scenario.world.placed()))
    await scenario.until(lambda: step in scenario.world.reached)
    for _ in range(3):
        await asyncio.sleep(0)
        scenario.put()
        assert scenario.waiting, "the put waits"
        await scenario.until(lambda: all(run.ack is not None for _, run, _ in scenario.waiting))
        scenario.note_acks()
    assert scenario.acknowledged == []
    scenario.world.is_cut_off = False
    await asyncio.gather(move, return_exceptions=True)
    scenario.put()
    scenario.check(await scenario.settle())


@pytest.mark.parametrize("step", STEPS[AFTER_THE_COMMIT:AFTER_THE_REMOVAL])
async def test_a_source_drops_nothing_if_the_destination_was_stopped_for_longer_than_its_lease(
    step: str,
) -> None:
    def stop(world: World) -> None:
        """Stop the host. Afterwards it continues without a lease, and says that it has everything that it needs."""
        world.expire(DESTINATION)
        world.hosts[DESTINATION].has_lease = False
        world.hosts[DESTINATION].store.fence()

    scenario = Scenario(step, stop)
    await scenario.move()
    assert scenario.world.owner is scenario.source
    scenario.check(await scenario.settle())


async def test_a_channel_that_has_moved_back_keeps_its_copy_after_a_late_answer_that_it_is_released(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario("source learns of the commit", lambda world: world.cut_links())
    requested, answer = asyncio.Event(), asyncio.Event()

    async def is_released(channel_id: bytes) -> bool:
        requested.set()
        await answer.wait()
        return True

    monkeypatch.setattr(scenario.source.directory, "is_released", is_released)
    await scenario.move()
    await requested.wait()
    # The channel moves back.
    scenario.source.store.copies.begin(scenario.world.record, NewCopy(CopyState(), Losses(), True))
    answer.set()
    await scenario.until(lambda: not scenario.source.outgoing._tasks)
    assert scenario.source.store.copies.of(scenario.world.channel_id) is not None


async def test_a_destination_that_freezes_does_not_keep_the_channel_from_other_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(feed_stream, "SILENT_SECONDS_MAX", 0.05)
    scenario = Scenario("feeding", lambda world: setattr(world.links[0], "is_frozen", True))
    hosted = await scenario.source.store.bind(scenario.world.channel_id, 1)
    scenario.world.allow(DESTINATION)
    move = asyncio.create_task(scenario.destination.incoming.move_here(*scenario.world.placed()))
    await scenario.until(lambda: hosted.moving is not None)
    await scenario.until(lambda: hosted.moving is None)
    assert not move.done()
    scenario.source.outgoing.check(hosted, id_of(DESTINATION))
    scenario.world.kill(DESTINATION)
    await asyncio.gather(move, return_exceptions=True)


async def test_a_copy_that_ends_its_side_while_its_feed_waits_for_a_turn_ends_the_feed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, the feed forgot the end, and waited for the next item."""
    work = WorkOfABusyCaller()
    monkeypatch.setattr(feed_writer, "current_work", lambda: work)
    scenario = Scenario()
    await scenario.source.store.bind(scenario.world.channel_id, 1)
    link = Link(scenario.world, scenario.source)
    opening = pb.FeedOpen(channel_id=scenario.world.channel_id, epoch=1, host_id=id_of(DESTINATION), target="proxy:1")
    await link.write(pb.FeedRequest(open=opening, credit_bytes=10**6))
    assert (await link.read()).fields.HasField("opened")
    work.must_wait = True
    scenario.put()
    await scenario.until(lambda: work.waits)
    link.done_writing()
    for _ in range(10):
        await asyncio.sleep(0)
    work.comes.set()
    assert link.serving is not None
    await asyncio.wait_for(link.serving, 10)


class WorkOfABusyCaller:
    """The work of a caller that waits for its turn, as `CallerWork`."""

    must_wait = waits = False

    def __init__(self) -> None:
        self.comes = asyncio.Event()

    async def turn(self) -> None:
        self.waits = True
        await self.comes.wait()

    def spend_write(self) -> None:
        self.must_wait = False


async def test_a_refused_move_leaves_no_feed_at_the_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another move begins while the directory notes that the replica begins anew."""
    scenario = Scenario()
    hosted = await scenario.source.store.bind(scenario.world.channel_id, 1)
    monkeypatch.setattr(scenario.source.outgoing, "check", lambda *_: None)
    monkeypatch.setattr(scenario.source.outgoing, "begin", _refuse)
    link = Link(scenario.world, scenario.source)
    opening = pb.FeedOpen(
        channel_id=scenario.world.channel_id, epoch=1, host_id=id_of(DESTINATION), target="host-2", owner_facts=True,
        move_id=b"m" * 16,
    )  # fmt: skip
    await link.write(pb.FeedRequest(open=opening))
    with pytest.raises(StampedeError, match="another move"):
        await link.read()
    held, _ = hosted.core.look(0)
    assert held._on_floor_reset is None


def _refuse(*_: object) -> None:
    raise MoveConflict("another move is under way")


async def test_the_counters_of_both_hosts_together_count_each_item_once() -> None:
    scenario = Scenario()
    await scenario.move()
    items = await scenario.settle()
    await scenario.until(lambda: scenario.source.store.known(scenario.world.channel_id) is None)
    counted = [accepted_by(host) for host in (scenario.source, scenario.destination)]
    assert sum(counted) == len(items)
    assert counted[0] >= ITEMS
    scenario.put()
    assert accepted_by(scenario.destination) == counted[1] + 1


def accepted_by(host: Host) -> float:
    families = run_to_end(ChannelMetrics(host.store, lambda name: True).families())
    return next(one.samples[0][1] for one in families if one.metric is catalog.ITEMS_ACCEPTED)


async def test_an_owner_that_lacks_the_last_facts_of_the_former_one_feeds_a_proxy_anew() -> None:
    """Otherwise the owner would always be behind the proxy, and refuse its feed each time."""
    scenario = Scenario()
    await scenario.source.store.bind(scenario.world.channel_id, 1)
    scenario.put()
    link = Link(scenario.world, scenario.source)
    place = pb.FeedPlace(incarnation=scenario.world.incarnation, next_seq=2, floor_resets=1, owner_epoch=1)
    opening = pb.FeedOpen(
        channel_id=scenario.world.channel_id, epoch=1, host_id=id_of(DESTINATION), target="proxy:1", place=place
    )
    await link.write(pb.FeedRequest(open=opening, credit_bytes=10**6))
    assert (await link.read()).fields.opened.begins_anew
    assert [len(one) > 0 for one in (await link.read()).runs] == [True]
    link.cut()


async def test_a_second_move_is_refused_while_one_is_under_way() -> None:
    scenario = Scenario()
    hosted = await scenario.source.store.bind(scenario.world.channel_id, 1)
    for number in (DESTINATION, THIRD):
        scenario.world.allow(number)
    scenario.source.outgoing.begin(hosted, id_of(DESTINATION), "other:1")
    with pytest.raises(MoveConflict, match="another move of channel cam is under way"):
        scenario.source.outgoing.begin(hosted, id_of(THIRD), "third:1")


async def test_a_host_gives_away_a_limited_number_of_channels_at_the_same_time() -> None:
    scenario = Scenario()
    hosted = await scenario.source.store.bind(scenario.world.channel_id, 1)
    scenario.world.allow(DESTINATION)
    for _ in range(move_slots.MOVES_MAX):
        scenario.source.outgoing.begin(hosted, id_of(DESTINATION), "other:1")
        hosted.moving = None
    with pytest.raises(StampedeError, match=f"{move_slots.MOVES_MAX} channels move away"):
        scenario.source.outgoing.begin(hosted, id_of(DESTINATION), "other:1")


async def test_a_host_that_stops_takes_no_channels() -> None:
    scenario = Scenario()
    await scenario.source.store.bind(scenario.world.channel_id, 1)
    scenario.destination.incoming.close()
    scenario.world.allow(DESTINATION)
    with pytest.raises(StampedeError, match="shutting down"):
        await scenario.destination.incoming.move_here(*scenario.world.placed())


@pytest.mark.parametrize("replica_at", [0, DESTINATION], ids=["plain", "with a replica at the destination"])
async def test_a_former_owner_drops_nothing_if_a_client_asks_it_before_it_knows_of_the_commit(
    replica_at: int,
) -> None:
    scenario = Scenario(replica_at=replica_at)
    hosted = await scenario.source.store.bind_for_feed(scenario.world.channel_id, 1)
    scenario.put()
    hosted.begin_move().hold()
    permit = scenario.source.outgoing.allowed.permit(scenario.world.channel_id, 1, id_of(DESTINATION))
    scenario.world.apply(CommitMove(channel_id=scenario.world.channel_id, epoch=1, to_host_id=id_of(DESTINATION),
                                 to_boot_incarnation=1, permit=permit))  # fmt: skip
    with pytest.raises(StampedeError):
        await scenario.source.store.bind(scenario.world.channel_id, 2)
    assert scenario.source.store.known(scenario.world.channel_id) is hosted
    await scenario.world.aclose()
