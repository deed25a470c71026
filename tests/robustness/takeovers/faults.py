"""Random faults of the hosts of a cluster in virtual time, some of them at the same time."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Coroutine
from typing import Any

from stampede_rt.errors import StampedeError
from tests.robustness.takeovers.world import Cluster

Fault = Callable[[int], Coroutine[Any, Any, None]]
FAULTY_SECONDS = 30.0
LEASE_ENDS_SECONDS = 7.0


class Faults:
    """The faults of one run. `owner_number` returns the number of a host that owns a channel or queue.

    `move`: one more fault. It moves channels or queues to the host with the given number, or away from this host.
    """

    def __init__(
        self, cluster: Cluster, rng: random.Random, owner_number: Callable[[], int], move: Fault
    ) -> None:  # fmt: skip
        self.cluster, self.rng = cluster, rng
        self.owner_number, self.move = owner_number, move
        self._running: list[asyncio.Task[None]] = []

    def kinds(self) -> list[Fault]:
        """The faults to choose from."""
        faults = [self.kill, self.stop, self.slow, self.cut, self.cut_off, self.change_leader, self.move]
        return [*faults, self.kill_behind_slow_links, self.kill_alone, self.kill_twice, self.lose_two_in_a_move]

    def begin(self, fault: Fault, number: int) -> None:
        """Begin a fault at this host. The fault ends by itself, or `disturb` cancels it."""
        self._running.append(asyncio.create_task(fault(number)))

    async def disturb(self) -> None:
        """Begin faults at random times. A fault may begin before the earlier ones have ended."""
        cluster, rng, faults = self.cluster, self.rng, self.kinds()
        ends_s = self.cluster.clock.now_s + FAULTY_SECONDS
        while self.cluster.clock.now_s < ends_s:
            await asyncio.sleep(rng.uniform(0.2, 5.0))
            self.begin(rng.choice(faults), rng.choice([*cluster.hosts, self.owner_number()]))
        for task in self._running:
            task.cancel()
        results = await asyncio.gather(*self._running, return_exceptions=True)
        for one in results:
            if isinstance(one, Exception) and not isinstance(one, StampedeError):
                raise one

    def _duration_seconds(self) -> float:
        return self.rng.choice((0.3, 1.0, 2.0, 4.5, 8.0)) * self.rng.uniform(0.8, 1.2)

    async def kill(self, number: int) -> None:
        if self.cluster.hosts[number].alive:
            self.cluster.kill(number)
            await asyncio.sleep(self._duration_seconds())
            if not self.cluster.hosts[number].alive:
                self.cluster.start(number)

    async def stop(self, number: int) -> None:
        host = self.cluster.hosts[number]
        host.running.clear()
        await asyncio.sleep(self._duration_seconds())
        host.running.set()

    async def slow(self, number: int) -> None:
        self.cluster.slow_s[number] = self.rng.choice((0.1, 0.3, 0.7, 1.5))
        await asyncio.sleep(self._duration_seconds())
        self.cluster.slow_s.pop(number, None)

    async def kill_behind_slow_links(self, number: int) -> None:
        """The owner dies while the replicas lack its latest items."""
        owner = self.owner_number()
        self.cluster.slow_s[owner] = self.rng.choice((0.2, 0.5, 0.9))
        await asyncio.sleep(self.rng.uniform(1.0, 2.0))
        self.cluster.slow_s.pop(owner, None)
        await self.kill(owner)

    async def kill_twice(self, number: int) -> None:
        """One replica lacks the latest items, the owner dies, and then the next owner dies, too."""
        owner = self.owner_number()
        behind = self.rng.choice([one for one in self.cluster.hosts if one != owner])
        self.cluster.slow_s[behind] = self.rng.choice((0.3, 0.6, 0.9))
        await asyncio.sleep(self.rng.uniform(0.6, 2.0))
        if self.cluster.hosts[owner].alive:
            self.cluster.kill(owner)
        self.cluster.slow_s.pop(behind, None)
        ends_s = self.cluster.clock.now_s + LEASE_ENDS_SECONDS
        while self.owner_number() == owner and self.cluster.clock.now_s < ends_s:  # noqa: ASYNC110 - in virtual time
            await asyncio.sleep(0.05)
        await asyncio.sleep(self.rng.choice((0.0, 0.5, 3.0)) * self.rng.random())
        await self.kill(self.owner_number())
        if not self.cluster.hosts[owner].alive:
            self.cluster.start(owner)

    async def lose_two_in_a_move(self, number: int) -> None:
        """Two hosts die or stop at any steps of a move: the source, the destination, or a host with a replica."""
        self.begin(self.move, number)
        for victim in self.rng.sample([*self.cluster.hosts], 2):
            await asyncio.sleep(self.rng.choice((0.0, 0.05, 0.1, 0.3)) * self.rng.random())
            self.begin(self.rng.choice((self.kill, self.kill, self.stop)), victim)

    async def kill_alone(self, number: int) -> None:
        """The owner reaches only its callers, and then dies."""
        owner = self.owner_number()
        self.cluster.cut_off.add(owner)
        for other in self.cluster.hosts:
            self.cluster.cut(owner, other)
        await asyncio.sleep(self.rng.uniform(0.5, 3.5))
        if self.cluster.hosts[owner].alive:
            self.cluster.kill(owner)
        self.cluster.cut_off.discard(owner)
        self.cluster.cut_pairs.clear()
        await asyncio.sleep(self._duration_seconds())
        if not self.cluster.hosts[owner].alive:
            self.cluster.start(owner)

    async def cut(self, number: int) -> None:
        other = self.rng.choice([one for one in self.cluster.hosts if one != number])
        self.cluster.cut(number, other)
        await asyncio.sleep(self._duration_seconds())
        self.cluster.cut_pairs.discard(frozenset((number, other)))

    async def cut_off(self, number: int) -> None:
        self.cluster.cut_off.add(number)
        await asyncio.sleep(self._duration_seconds())
        self.cluster.cut_off.discard(number)

    async def change_leader(self, number: int) -> None:
        self.cluster.is_cut_off = True
        await asyncio.sleep(min(self._duration_seconds(), 4.8))
        self.cluster.another_leader()
        self.cluster.is_cut_off = False
