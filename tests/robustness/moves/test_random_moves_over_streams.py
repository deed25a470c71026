"""Random moves to and fro in virtual time: many of them share a stream, while links break and hosts freeze."""

from __future__ import annotations

import asyncio
import os
import random

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from tests.robustness.moves import two_hosts
from tests.robustness.moves.two_hosts import DESTINATION, SOURCE, STEPS, Host, World
from tests.support.supernode.operations import id_of
from tests.support.virtual_time import VirtualClock, run_virtually

SEEDS = int(os.environ.get("STAMPEDE_MOVE_SEEDS", "4"))
CHANNELS, ROUNDS = 5, 6
QUIET_SECONDS = 30.0  # after this time each move has ended, and so has each stream that waits for a move


class RandomMoves:
    """Channels at two hosts, with puts that go on, and moves with a fault in each round."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.world = World("", lambda world: None, channels=CHANNELS)
        self.next = dict.fromkeys(self.world.channel_ids, 1)
        self.waiting: list[tuple[bytes, int, IncomingRun]] = []
        self.acknowledged: dict[bytes, list[int]] = {one: [] for one in self.world.channel_ids}
        self.events: list[str] = []

    async def run(self) -> None:
        """Play all rounds, and check the channels after each round."""
        for one in self.world.channel_ids:
            await self.world.owner_of(one).store.bind(one, 1)
            self._put(one)
        for _ in range(ROUNDS):
            await self._round()
            await self._settle()
        await self._check_idle()
        await self.world.aclose()

    async def _round(self) -> None:
        self.world.reached.clear()
        self.world.crash_at = self.random.choice(["", *STEPS])
        self.world.happens = self.random.choice([self._cut, self._freeze])
        self.events.append(f"{self.world.crash_at}: {self.world.happens.__name__}")
        moves = [
            asyncio.create_task(self._move(one))
            for one in self.random.sample(self.world.channel_ids, self.random.randint(1, CHANNELS))
            for _ in range(self.random.choice([1, 1, 2]))  # two drains, or a drain and a caller
        ]
        while not all(move.done() for move in moves):
            self._put(self.random.choice(self.world.channel_ids))
            await asyncio.sleep(self.random.choice([0.0, 0.0, 0.01]))
        for move in moves:
            await move

    def _cut(self, world: World) -> None:
        world.cut_links()

    def _freeze(self, world: World) -> None:
        host = world.hosts[self.random.choice([SOURCE, DESTINATION])]
        host.running.clear()
        asyncio.get_running_loop().call_later(self.random.choice([0.1, 2.0, 10.0]), host.running.set)

    async def _move(self, channel_id: bytes) -> None:
        await asyncio.sleep(self.random.choice([0.0, 0.0, 0.02, 0.5]))
        owner = self.world.owner_of(channel_id)
        to = DESTINATION if owner is self.world.hosts[SOURCE] else SOURCE
        placed = self.world.placed(channel_id)
        owner.outgoing.allowed.allow(channel_id, placed[0].epoch, id_of(to))
        try:
            async with asyncio.timeout(QUIET_SECONDS):
                await self.world.hosts[to].incoming.move_here(*placed, is_of_drain=self.random.random() < 0.5)
        except (StampedeError, TimeoutError) as error:
            self.events.append(str(error))

    def _put(self, channel_id: bytes) -> None:
        self._note_acks()
        for host in self.world.hosts.values():
            run = host.put(self.next[channel_id], channel_id)
            if run is not None:
                self.waiting.append((channel_id, self.next[channel_id], run))
                self.next[channel_id] += 1
                break
        self._note_acks()

    def _note_acks(self) -> None:
        for each in [one for one in self.waiting if one[2].ack is not None]:
            self.waiting.remove(each)
            channel_id, number, run = each
            if run.ack is not None and not run.ack.HasField("error"):
                self.acknowledged[channel_id].append(number)

    async def _settle(self) -> None:
        """Wait until no move and no put is under way. Check that no acknowledged item is lost or there twice."""
        async with asyncio.timeout(QUIET_SECONDS):
            for channel_id in self.world.channel_ids:
                items = await self._items_at_last(channel_id)
                assert set(self.acknowledged[channel_id]) <= set(items), self.events
                assert len(set(items)) == len(items), self.events

    async def _items_at_last(self, channel_id: bytes) -> list[int]:
        while True:
            items = await self._items(channel_id)
            if items is not None:
                return items
            await asyncio.sleep(0.1)

    async def _items(self, channel_id: bytes) -> list[int] | None:
        self._note_acks()
        owner, record = self.world.owner_of(channel_id), self.world.record_of(channel_id)
        try:
            hosted = await owner.store.bind(channel_id, record.epoch)
        except StampedeError:
            return None
        is_over = hosted.moving is None and not self.waiting
        return owner.items(hosted) if is_over else None

    async def _check_idle(self) -> None:
        """Check that after the last move no host still has a slot, a stream or a hold."""
        await asyncio.sleep(QUIET_SECONDS)
        for host in self.world.hosts.values():
            assert not _left_over(host), (host.identity.name, _left_over(host), self.events)
        assert all(link.serving is None or link.serving.done() for link in self.world.links), self.events


def _left_over(host: Host) -> list[object]:
    incoming, outgoing = host.incoming, host.outgoing
    held = [one.record.name for one in host.store.all() if one.moving is not None]
    slots = [one for one in (incoming._slots.under_way, outgoing._slots.under_way) if one]
    return [*held, *slots, *incoming._moves, *incoming._streams._free, *outgoing._tasks]


@pytest.mark.parametrize("seed", range(SEEDS))
def test_streams_that_carry_many_moves_lose_no_item_and_leave_no_slot_stream_or_hold(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def play(clock: VirtualClock) -> None:
        monkeypatch.setattr(two_hosts, "SystemClock", lambda: clock)
        await RandomMoves(seed).run()

    run_virtually(play, seed)
