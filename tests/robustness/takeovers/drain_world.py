"""Hosts that drain their channels, in virtual time. Drains, their streams and early holds run the product's code."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.copies.moves.drain_requests import METHOD
from stampede_rt_channel_host.copies.moves.draining import DrainResult, HostDrain
from stampede_rt_channel_host.copies.moves.migration_servicer import MigrationServicer
from stampede_rt_supernode.core.commands import Operation
from stampede_rt_supernode.core.hosts.commands import ExpireHost, RegisterHost
from stampede_rt_supernode.core.replicas.copied_subjects import Copied
from tests.robustness.moves.links import Link
from tests.robustness.moves.two_hosts import World
from tests.robustness.takeovers.streams import Call, Connection, Method
from tests.robustness.takeovers.world import Cluster, LeasedHost
from tests.support.supernode.operations import open_channel
from tests.support.virtual_time import VirtualClock


class DrainedHost(LeasedHost):
    """A host that drains, and takes over the channels of other hosts that drain."""

    def __init__(self, world: World, number: int, boot: int = 1) -> None:
        super().__init__(world, number, boot)
        none: Any = SimpleNamespace(all=list)  # a host without queues
        allow = self.outgoing.allowed.allow
        self.draining = HostDrain(
            self.store, none, self.directory, lambda channel_id: [], self.dial, self._dial_stream, allow
        )
        servicer = MigrationServicer(
            self.incoming, none, none, self.directory, self.draining, none, self.identity, allow, OpenStreams()
        )

        async def move_each_here(context: Any) -> None:
            requests: Any = None
            await servicer.MoveEachHere(requests, context)

        self.methods = {METHOD: Method(move_each_here, pb.MoveEachHereRequest.FromString)}
        self.drains: set[asyncio.Task[DrainResult]] = set()

    def _dial_stream(self, target: str) -> Any:
        assert isinstance(self.world, DrainCluster)
        host = self.world.hosts[int(target.removeprefix("host-"))]
        return Connection(self.world, host, host.methods, self)

    def tasks(self) -> list[asyncio.Task[Any]]:
        return [*super().tasks(), *self.drains]

    async def drain(self, seconds: float) -> DrainResult:
        """Drain this host, as an operator does."""
        drain = asyncio.create_task(self.draining.run(seconds))
        self.drains.add(drain)
        drain.add_done_callback(self.drains.discard)
        return await drain


class DrainCluster(Cluster):
    """The directory, its hosts, and several channels without replicas."""

    host_type = DrainedHost

    def __init__(self, clock: VirtualClock, seed: int, count: int, channels: int) -> None:
        self._count = channels
        self.steps: Counter[str] = Counter()  # how often a move has reached each step
        self.handed_over = asyncio.Event()  # set when a channel is handed over the next time
        self._breaks: tuple[int, Callable[[Call | Link], None]] | None = None
        super().__init__(clock, seed, count, Policy())

    def _open(self, policy: Policy) -> None:
        for number in range(self._count):
            self.log.apply(open_channel(f"cam{number}", incarnation=1000 * (number + 1), max_items=100_000))
        self.channel_ids = [*self.log.directory.tables.channels]
        self.channel_id = self.channel_ids[0]

    def copied(self) -> list[Copied]:
        return [*self.log.directory.tables.channels.values()]

    def at(self, step: str) -> None:
        self.steps[step] += 1
        if step == "handed over":
            handed_over, self.handed_over = self.handed_over, asyncio.Event()
            handed_over.set()

    @property
    def early_holds(self) -> int:
        """How often an owner handed over a channel that it held without a request for the hold (decision 0280)."""
        return self.steps["handed over"] - self.steps["held"]

    def owned_channels(self, number: int) -> int:
        """The number of channels whose owner is this host, by the directory."""
        tables = self.log.directory.tables
        return len([*tables.channels_at(self.hosts[number].identity.host_id)])

    def apply(self, operation: Operation) -> Any:
        before = {one.channel_id: (one.incarnation, one.host_id) for one in self.log.directory.tables.channels.values()}
        try:
            return super().apply(operation)
        finally:
            for one in self.log.directory.tables.channels.values():
                incarnation, host_id = before.get(one.channel_id, (one.incarnation, b""))
                ends_lease = isinstance(operation, ExpireHost | RegisterHost) and operation.host_id == host_id
                assert incarnation == one.incarnation or ends_lease, f"{operation} has lost items of a live host"

    # Breaks at a message.

    def break_at(self, message: int, happens: Callable[[Call | Link], None]) -> None:
        """Call `happens` when the message with this number passes (1: the next one), with the stream of this message.

        Counts only messages of drains and of moves.
        """
        self._breaks = message, happens

    def passes(self, link: Any) -> None:
        is_of_drain = isinstance(link, Call) or link.is_of_move
        if self._breaks is None or not is_of_drain:
            return
        left, happens = self._breaks
        self._breaks = (left - 1, happens) if left > 1 else None
        if self._breaks is None:
            asyncio.get_running_loop().call_soon(happens, link)
