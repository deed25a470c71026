"""The callers of one simulated channel, and their knowledge: producers, and a reader of all items.

Producers put numbered items one after the other, and put an item again until it is acknowledged.
"""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress

from stampede_rt.errors import StampedeError
from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.puts.held_acks import AckOfReplicas
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.put_requests import Put
from stampede_rt_channel_host.channels.puts.wanted_acks import held_ack
from tests.robustness.takeovers.world import Cluster, LeasedHost, serving

ACK_SECONDS = 2.0
LAG_SECONDS_MAX, SLACK_SECONDS = 1.0, 0.1
FACTOR = 16  # greater than the number of each producer

Item = tuple[int, int]
"""A producer and the number of its item."""


class ChannelCallers:
    """The callers of one channel. `pause_seconds`: the mean pause of a producer after each item."""

    def __init__(
        self, cluster: Cluster, channel_id: bytes, policy: Policy, rng: random.Random, pause_seconds: float
    ) -> None:  # fmt: skip
        self.cluster, self.channel_id, self.policy, self.rng = cluster, channel_id, policy, rng
        self.clock, self.pause_seconds = cluster.clock, pause_seconds
        self.acknowledged: set[Item] = set()
        self._repeated: set[Item] = set()  # their acks may be for an earlier put
        self.last_ack_s: dict[int, float] = {}  # by incarnation
        self.known: dict[int, dict[Item, float]] = {}  # by incarnation: when each item was first acknowledged or seen

    def owner(self) -> LeasedHost | None:
        """The owner, if callers reach it."""
        host = self.cluster.hosts[self.owner_number()]
        return host if host.alive and host.running.is_set() else None

    def owner_number(self) -> int:
        return int.from_bytes(self.cluster.record_of(self.channel_id).host_id, "big")

    async def produce(self, producer: int) -> None:
        """Put items one after the other."""
        number = 1
        while True:
            item = producer, number
            with suppress(StampedeError, TimeoutError):
                async with asyncio.timeout(ACK_SECONDS + 1):
                    if await self._put(producer, number):
                        number += 1
            self._repeated.add(item)
            await self.pause()

    async def pause(self) -> None:
        """Wait between two items of a producer."""
        await asyncio.sleep(self.rng.uniform(0, 2 * self.pause_seconds))

    async def _put(self, producer: int, number: int) -> bool:
        host = self.owner()
        if host is None:
            return False
        hosted = await host.store.bind(self.channel_id, self.cluster.record_of(self.channel_id).epoch)
        run = IncomingRun(
            encode_run([b"an item"], times=[number * FACTOR + producer]), producer_id=producer, first_number=number,
            wait_nanos=round(ACK_SECONDS * 1e9),
        )  # fmt: skip
        run.keep()
        ack = hosted.puts.put(run, host.store.now())
        if ack is None:
            try:
                ack = await run.wait(hosted.puts.give_up)
            finally:
                hosted.puts.withdraw(run)
        held = held_ack(ack, hosted, Put(number, round(ACK_SECONDS * 1e9), b""), self.clock.monotonic())
        if isinstance(held, AckOfReplicas):
            ack = await held.due()
        if not host.alive or ack.HasField("error") or not ack.HasField("first_seq"):
            return False
        if (producer, number) not in self._repeated:
            self._check_replicas(host)
        self.acknowledged.add((producer, number))
        self.last_ack_s[ack.incarnation] = self.clock.now_s
        self._know(ack.incarnation, (producer, number))
        return True

    def _check_replicas(self, host: LeasedHost) -> None:
        """Check that the directory has enough replicas in sync for an ack of the owner."""
        if self.policy.ack == "replica" and self.owner() is host:
            count = len([*self.cluster.successors(self.channel_id)])
            assert count >= (self.policy.min_replicas or 0), "an item is acknowledged that no replica would keep"

    def _know(self, incarnation: int, item: Item) -> None:
        self.known.setdefault(incarnation, {}).setdefault(item, self.clock.now_s)

    async def read(self) -> None:
        """Read the items at the owner again and again."""
        while True:
            await asyncio.sleep(self.rng.uniform(0.1, 0.5))
            self.look()

    def served(self) -> HostedChannel | None:
        """The channel at its owner. None if the owner does not serve it now, for instance because it has no lease."""
        at = serving(self.cluster, self.channel_id)
        assert len(at) <= 1, "two hosts serve the channel"
        host = self.owner()
        is_served = host is not None and at and self.cluster.hosts[at[0]] is host
        return host.store.known(self.channel_id) if host is not None and is_served else None

    def look(self) -> list[Item]:
        """Note the items that readers see."""
        hosted = self.served()
        if hosted is None:
            return []
        items = items_of(hosted)
        assert len(set(items)) == len(items), "an item is there twice"
        for item in items:
            self._know(hosted.channel.incarnation, item)
        return items

    def judge(self, items: list[Item]) -> int:
        """Check that all lost items are items that may be lost. Returns their number."""
        there, order = set(items), self.cluster.incarnations[self.channel_id]
        lost = 0
        for at, incarnation in enumerate(order):
            times = self.known.get(incarnation, {})
            if not is_continued(order, at):
                continue  # no replica was in sync
            missing = {item: since for item, since in times.items() if item not in there}
            lost += len(missing)
            # A reader may have seen later items, but no producer has their acks.
            last_s = self.last_ack_s.get(incarnation, 0.0)
            ends_at = self.policy.ack == "host" and at + 1 < len(order)
            early = [
                item
                for item, since in missing.items()
                if not ends_at or since < last_s - LAG_SECONDS_MAX - SLACK_SECONDS
            ]
            assert not early, f"{len(early)} items of incarnation {at} are lost too early: {sorted(early)[:3]}"
        return lost


def is_continued(order: list[int], at: int) -> bool:
    """Whether all later incarnations have begun with the items of a replica."""
    return all(after == (before + 1) % 2**64 for before, after in zip(order[at:], order[at + 1 :], strict=False))


def items_of(hosted: HostedChannel) -> list[Item]:
    """The items that readers see. The time of an item names it."""
    times = [time for part in hosted.channel.accepted_from(1) for time in part.run.times[part.lo : part.hi]]
    return [(time % FACTOR, time // FACTOR) for time in times]
