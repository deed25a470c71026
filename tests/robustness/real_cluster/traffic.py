"""Clients of the product that put and read items at real channel hosts, and record the answers."""

from __future__ import annotations

import asyncio
import random
import time
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_runtime.identity import Role
from tests.robustness.histories.operations import Recorder
from tests.robustness.histories.ownership_model import AllItems, ItemStored, Newest, NewestSeq, Put, ReadAll
from tests.robustness.real_cluster.cluster import Cluster

CLIENT = "traffic"
TRANSPORTS = ("best", "grpc", "tcp")
NAMES_IN_USE, NAMES_CHANGE_SECONDS = 3, 10.0
PAUSE_SECONDS = 0.05
MAX_AGE = "1h"  # longer than any campaign, so that retention collects nothing
ITEMS_MAX = 1_000_000


class Traffic:
    """Several workers on one connection. Enter it as a context manager before `run`."""

    def __init__(self, cluster: Cluster, recorder: Recorder, seed: int, **policy: Any) -> None:
        """`policy`: the policy of all channels, in addition to their limits."""
        self._cluster, self.recorder, self._policy = cluster, recorder, policy
        self._random_source = random.Random(f"traffic-{seed}")
        self.transport = self._random_source.choice(TRANSPORTS)
        """The transport of the connection."""
        self._numbers = 0
        self._handles: dict[str, aio.Channel] = {}
        self._rt: aio.Connection | None = None
        self.failed = 0  # the calls that ended with an error; each may or may not have had its effect

    async def __aenter__(self) -> Traffic:
        assert self._cluster.frontend is not None
        files = self._cluster.caller_files(Role.CLIENT, CLIENT)
        address = self._cluster.frontend.address
        self._rt = await aio.connect(address, tls=files, transport=self.transport).__aenter__()
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self.rt.aclose()

    @property
    def rt(self) -> aio.Connection:
        """The connection."""
        assert self._rt is not None, "enter the traffic first"
        return self._rt

    @property
    def waits_for_replicas(self) -> bool:
        """Whether puts into the channels wait for replicas."""
        return self._policy.get("ack") == "replica"

    async def run(self, began_s: float) -> None:
        """Put and read until cancelled. Uses a few channels at a time, and new ones after NAMES_CHANGE_SECONDS.

        `began_s`: the start of the campaign, by the monotonic clock.
        """
        while True:
            age = int((time.monotonic() - began_s) / NAMES_CHANGE_SECONDS)
            await self.once(f"robust-data/{age}-{self._random_source.randrange(NAMES_IN_USE)}")
            await asyncio.sleep(self._random_source.uniform(0, 2 * PAUSE_SECONDS))

    async def once(self, name: str) -> None:
        """Make one random call about one channel, and record it."""
        chance = self._random_source.random()
        try:
            channel = await self.open(name)
            if chance < 0.6:
                await self.put(channel)
            elif chance < 0.95:
                await self.newest(channel)
            else:
                await self.read_all(channel)
        except st.StampedeError:
            self.failed += 1

    async def open(self, name: str, host: str | None = None) -> aio.Channel:
        """Open the channel, and create it if it does not exist. Raises StampedeError."""
        if name not in self._handles:
            policy = {"max_age": MAX_AGE, "max_items": ITEMS_MAX} | self._policy
            self._handles[name] = await self.rt.channel(name, host=host, **policy)
        return self._handles[name]

    def in_use(self) -> list[aio.Channel]:
        """The channels that the workers and the faults have opened most recently."""
        return [*self._handles.values()][-2 * NAMES_IN_USE :]

    async def put(self, channel: aio.Channel) -> st.Item:
        """Put an item that no other caller puts. Raises StampedeError."""
        self._numbers += 1
        call, invoked = Put(f"{self._numbers}".encode()), time.monotonic()
        try:
            item = await channel.put(call.payload)
        except BaseException:
            self.recorder.ambiguous(channel.name, call, invoked)
            raise
        self.recorder.done(channel.name, call, invoked, ItemStored(item.incarnation, item.seq))
        return item

    async def newest(self, channel: aio.Channel) -> None:
        """Get the newest item. Raises StampedeError."""
        invoked = time.monotonic()
        items = await channel.get(st.OLDEST, st.NEWEST, newest_first=True, limit=1, payloads=False)
        seq = items[0].seq if items else 0
        self.recorder.done(channel.name, Newest(), invoked, NewestSeq(items.incarnation, seq))

    async def read_all(self, channel: aio.Channel) -> None:
        """Get all items. Raises StampedeError."""
        invoked = time.monotonic()
        items = await channel.get(st.OLDEST, st.NEWEST)
        listed = tuple((item.seq, item.payload or b"") for item in items)
        self.recorder.done(channel.name, ReadAll(), invoked, AllItems(items.incarnation, listed))
