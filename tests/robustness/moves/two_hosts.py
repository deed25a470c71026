"""Hosts and a directory in one process. The product's code performs the moves. The test can cut the links between the
hosts, and the calls to the directory.

There are two hosts. There is a third one if the channel has replicas, or if the test wants one. If the channel has
replicas, the product's keepers of replicas run at each host.

`World.crash_at` names the step of a move at which the test interferes. `STEPS` has all steps, in their order.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from stampede_rt.errors import StampedeError, error_for
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.copies.keeper import CopyKeeper
from stampede_rt_channel_host.copies.moves.incoming_moves import IncomingMoves
from stampede_rt_channel_host.copies.moves.outgoing_moves import OutgoingMoves
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.copies.replica_keeper import ReplicaKeeper
from stampede_rt_channel_host.copies.replica_servicer import ReplicaServicer
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_runtime.access.move_permits import KEY_BYTES
from stampede_rt_runtime.clock import HostClock, SystemClock
from stampede_rt_supernode.codecs.record_codec import channel_record
from stampede_rt_supernode.core.cluster.feature_levels import MOVES_LEVEL
from stampede_rt_supernode.core.commands import Operation, RefusedOperation
from tests.robustness.moves.links import Connection, Link
from tests.robustness.moves.simulated_directory import SimulatedDirectory
from tests.support.supernode.operations import Log, add_replica, expire, id_of, open_channel, register

STEPS = (
    "feeding", "held", "handed over", "commit is asked for", "committed", "source learns of the commit",
    "removal is asked for", "removed", "source learns of the release",
)  # fmt: skip
SOURCE, DESTINATION, THIRD = 1, 2, 3


def key_of(number: int) -> bytes:
    """The key of a host's permits."""
    return bytes([number]) * KEY_BYTES


class World:
    """The directory, the hosts, and the step at which `happens` is called."""

    def __init__(
        self, crash_at: str, happens: Callable[[World], None], replica_at: int = 0, *, third: bool = False,
        channels: int = 1,
    ) -> None:  # fmt: skip
        """`replica_at`: the host with the replica; 0: the channel has none. `third`: the test wants a third host.

        `channels`: the number of channels, all at the source. `channel_id` is the id of the first channel.
        """
        self.crash_at, self.happens = crash_at, happens
        self.reached: list[str] = []
        self.channels_per_entry_max = 0  # the most channels that one entry of the log has committed
        self.log = Log(level=MOVES_LEVEL)
        numbers = (SOURCE, DESTINATION, THIRD) if replica_at or third else (SOURCE, DESTINATION)
        for number in numbers:
            self.log.apply(register(number, move_key=key_of(number)))
        replicas: dict[str, Any] = {"replicas": 1, "ack": "replica"} if replica_at else {}
        for number in range(channels):
            name = f"cam{number or ''}"
            self.log.apply(open_channel(name, host="host-1", max_items=100_000, **replicas))
        self.channel_ids = [*self.log.directory.tables.channels]
        self.channel_id = self.channel_ids[0]
        self.incarnation = self.record.incarnation
        self.is_cut_off = False  # no host reaches the directory
        self.commits: dict[bytes, RecordedChannel] = {}  # by the id of the request, which may come again
        self.clock: HostClock = SystemClock()
        self.links: list[Link] = []
        self.hosts = {number: Host(self, number) for number in numbers}
        if replica_at:
            self.apply(add_replica(self.channel_id, replica_at, warm=True, acknowledged=True))

    @property
    def record(self) -> RecordedChannel:
        return self.record_of(self.channel_id)

    def record_of(self, channel_id: bytes) -> RecordedChannel:
        return recorded_channel(channel_record(self.log.directory.tables.channels[channel_id]))

    def placed(self, channel_id: bytes = b"") -> tuple[RecordedChannel, FeedSource]:
        """The record and the owner of a channel; without an id, of the first channel."""
        record = self.record_of(channel_id or self.channel_id)
        return record, FeedSource(record.host_id, self.target_of(record.host_id), record.epoch)

    def target_of(self, host_id: bytes) -> str:
        """The address of a host: its name. Empty if the host is not alive."""
        host = self.log.directory.tables.hosts[host_id]
        return host.name if host.alive else ""

    def at(self, step: str) -> None:
        """Note that the protocol has reached this step."""
        if step not in self.reached:
            self.reached.append(step)
            if step == self.crash_at:
                self.happens(self)

    def kill(self, number: int) -> None:
        """End a host immediately. Its lease ends when `expire` is called."""
        host = self.hosts[number]
        host.alive = False
        for link in self.links:
            if host in (link.source, link.caller):
                link.cut()
        for task in host.tasks():
            task.cancel()

    def allow(self, to: int, epoch: int | None = None, channel_id: bytes = b"") -> None:
        """Allow a host to ask the owner for the channel. A client does this with AllowMove before a move."""
        record = self.record_of(channel_id or self.channel_id)
        self.owner_of(record.channel_id).outgoing.allowed.allow(record.channel_id, epoch or record.epoch, id_of(to))

    def cut_links(self) -> None:
        """Break the streams between the hosts of the move."""
        for link in self.links:
            if {link.source, link.caller} == {self.hosts[SOURCE], self.hosts[DESTINATION]}:
                link.cut()

    async def aclose(self) -> None:
        """End all tasks of the hosts."""
        for host in self.hosts.values():
            for task in host.tasks():
                task.cancel()
        for link in self.links:
            link.cut()
        await asyncio.sleep(0)

    def delay_s(self, link: Link) -> float:
        """The time that a message takes over a link."""
        return 0.0

    def passes(self, link: Any) -> None:
        """Called when a message begins its way over a link. Subclasses override it."""

    def reaches(self, link: Link) -> bool:
        """Whether there is a way between the hosts of a link."""
        return True

    def is_destination(self, host: Host) -> bool:
        """Whether the test moves channels to this host."""
        return host is self.hosts[DESTINATION]

    async def on_the_way(self, host: Host) -> None:
        """Wait while a call of a host is on its way to the directory, or while the answer is on its way back."""
        await asyncio.sleep(0)

    def expire(self, number: int) -> None:
        self.log.apply(expire(number, registered_index=number + 1))

    def apply(self, operation: Operation) -> Any:
        done = self.log.apply(operation)
        if isinstance(done, RefusedOperation):
            raise error_for(done.reason, done.message, dict(done.metadata))
        return done

    @property
    def owner(self) -> Host:
        return self.owner_of(self.channel_id)

    def owner_of(self, channel_id: bytes) -> Host:
        owner_id = self.record_of(channel_id).host_id
        return next(host for host in self.hosts.values() if host.identity.host_id == owner_id)


class Host:
    """One host: its store, its moves, and its calls to the directory."""

    def __init__(self, world: World, number: int, boot: int = 1) -> None:
        self.world = world
        self.alive = True
        self.has_lease = True
        self.registered_index = 0  # the log position of its registration; 0: it states none
        self.running = asyncio.Event()  # cleared while its process is stopped
        self.running.set()
        self.identity = HostIdentity(
            host_id=id_of(number), name=f"host-{number}", boot_incarnation=boot, move_key=key_of(number)
        )
        self.store = ChannelStore(
            self.identity,
            SimulatedDirectory(self),  # type: ignore[arg-type]  # `resolve` is all that the store needs here
            world.clock,
            lease_held=self.holds_lease,
            memory=MemoryBudget(2**26),
        )
        directory: Any = SimulatedDirectory(self)
        self.directory = directory
        self.copies = CopyKeeper(self.identity, self.store, directory, self.dial)
        self.copies.target = self.identity.name
        self.replicas = ReplicaKeeper(self.identity, self.store, directory, self.dial)
        self.outgoing = OutgoingMoves(self.identity, self.store, directory, self.copies)
        self.incoming = IncomingMoves(self.identity, self.store, directory, self.copies, self.dial)
        callers: Any = _AnyCaller()
        self.servicer = ReplicaServicer(self.store, OpenStreams(), lambda channel_id: [], self.outgoing, callers)

    def holds_lease(self) -> bool:
        return self.alive and self.has_lease

    def tasks(self) -> list[asyncio.Task[Any]]:
        """All work in the background."""
        copies = [one.task for one in self.copies._copies.values() if one.task is not None]
        return [*self.incoming._moves.values(), *self.outgoing._tasks, *self.replicas._tasks, *copies]

    def dial(self, target: str) -> Any:
        number = int(target.removeprefix("host-"))
        return Connection(self.world, self.world.hosts[number], self)

    def put(self, number: int, channel_id: bytes = b"") -> IncomingRun | None:
        """Put an item as producer 1. None: this host answers that it does not serve the channel."""
        record = self.world.record_of(channel_id or self.world.channel_id)
        try:
            hosted = self.store.find(record.channel_id, record.epoch)
        except StampedeError:
            return None
        run = IncomingRun(
            encode_run([b"%d" % number], times=[number]), producer_id=1, first_number=number, wait_nanos=None
        )
        run.keep()
        hosted.puts.put(run, self.store.now())
        return run

    def items(self, hosted: HostedChannel) -> list[int]:
        return [time for part in hosted.channel.accepted_from(1) for time in part.run.times[part.lo : part.hi]]


class _AnyCaller:
    """The check of the callers of feeds, in a cluster without certificates."""

    async def check(self, context: Any, host_id: bytes) -> None:
        pass
