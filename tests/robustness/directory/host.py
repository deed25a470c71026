"""Channel hosts in simulated time: the production lease and channel store, with a short registration."""

from __future__ import annotations

import itertools
from typing import Any

from stampede_rt.cluster.registration_epoch import RegistrationEpoch
from stampede_rt.errors import LeaseExpired, StaleRegistration, StampedeError
from stampede_rt.v1 import directory_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.host_lease import HostLease
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import Pieces, run_to_end
from tests.robustness.directory.asking import ask
from tests.robustness.directory.tasks import drive
from tests.robustness.directory.world import Clock, DirectoryWorld
from tests.support.supernode.list_machine import PromiseBroken

CHANNELS_LISTED_MAX = 1000


class UnslicedWork(PieceScheduler):
    """Performs all pieces of long work in one go, without an event loop."""

    def begin(self, pieces: Pieces[None]) -> None:
        """Perform all pieces."""
        for _ in pieces:
            pass


class Ownership:
    """The rule that at each moment of true time at most one host serves a channel. Checks all hosts."""

    def __init__(self) -> None:
        self.hosts: list[SimHost] = []
        self.puts = 0
        self._highest: dict[bytes, int] = {}

    def acknowledged(self, channel_id: bytes, epoch: int) -> None:
        """Note that a host has taken an item under this epoch. Raises PromiseBroken if that breaks a rule."""
        self.puts += 1
        if epoch < self._highest.get(channel_id, 0):
            raise PromiseBroken(f"a host took an item under epoch {epoch} after one under {self._highest[channel_id]}")
        self._highest[channel_id] = epoch
        self.check(channel_id)

    def check(self, channel_id: bytes) -> None:
        """Raises PromiseBroken if two hosts would serve the channel at this moment."""
        serving = [(host.identity.name, epoch) for host in self.hosts if (epoch := host.epoch_served(channel_id))]
        if len(serving) > 1:
            raise PromiseBroken(f"channel {channel_id.hex()} is served by {serving} at one moment")


class SimHost:
    """One host. It restarts with a new boot incarnation, freezes, and sometimes cannot reach the directory."""

    def __init__(self, world: DirectoryWorld, number: int, ownership: Ownership) -> None:
        self.world, self._ownership = world, ownership
        self._host_id = (number + 1).to_bytes(16, "big")
        self._boots = itertools.count(1)
        self.clock = Clock(world)
        self.frozen_until = 0.0
        self._registered_index = 0
        ownership.hosts.append(self)
        world.counts_on_lease[self._host_id] = lambda boot: (
            boot == self.identity.boot_incarnation and self.store.lease_held()
        )
        self.restart()

    def restart(self) -> None:
        """Kill and start the host. Only its id stays."""
        number = int.from_bytes(self._host_id, "big")
        self.identity = HostIdentity(
            host_id=self._host_id, name=f"host-{number}", boot_incarnation=1000 * number + next(self._boots)
        )
        self.lease, self.epoch = HostLease(), RegistrationEpoch()
        self.store = ChannelStore(
            self.identity,
            self,  # type: ignore[arg-type]  # `resolve` is all that the store needs here
            self.clock,
            lease_held=lambda: self.lease.is_held(self.clock.boottime_nanos()),
            memory=MemoryBudget(2**30),
        )
        self.store.scheduler = UnslicedWork()
        self._binding: set[bytes] = set()
        self._run(self._keep)

    def epoch_served(self, channel_id: bytes) -> int:
        """The epoch under which the host would serve the channel now; 0: the host would not serve the channel."""
        held = (one for one in self.store.all() if one.record.channel_id == channel_id)
        served = next(held, None)
        return served.epoch if served is not None and self.store.lease_held() else 0

    def put(self, channel_id: bytes, epoch: int) -> None:
        """Take a put of a caller."""
        self._run(lambda: self._take(channel_id, epoch))

    def _run(self, make: Any) -> None:
        boot = self.identity.boot_incarnation
        drive(make, alive=lambda: self.identity.boot_incarnation == boot, gate=self._when_awake)

    def _when_awake(self, call: Any) -> None:
        if self.frozen_until > self.world.now:
            self.world.at(self.frozen_until + self.world.random_source.random() * 0.001, call)
        else:
            call()

    async def _take(self, channel_id: bytes, epoch: int) -> None:
        binding = self._binding  # belongs to this start of the process
        if channel_id in binding:
            # the production code would wait here for the store's lock, which needs an event loop; the caller tries
            # again
            return
        binding.add(channel_id)
        try:
            await self.store.bind(channel_id, epoch)
            self.store.find(channel_id, epoch)
            self._ownership.acknowledged(channel_id, epoch)
        except StampedeError:
            pass  # the caller tries again
        finally:
            binding.discard(channel_id)

    async def resolve(self, channel_id: bytes) -> Any:
        """Like `stampede_rt_channel_host.cluster.directory.DirectoryQueries.resolve`."""
        response = await ask(
            self.world, "ResolveChannel", pb.ResolveChannelRequest(channel_id=channel_id), 4.0, caller=self
        )
        return recorded_channel(response.channel)

    async def _keep(self) -> None:
        while True:
            try:
                await (self._renew() if self.store.lease_held() else self._enter())
            except LeaseExpired:
                self.lease.give_up()
            except StaleRegistration as error:
                if self.epoch.may_overtake(error):
                    continue
            except StampedeError:
                pass  # tried again below
            await self.world.sleep(max(0.05, self.lease.renewal_in_nanos(self.clock.boottime_nanos()) / 1e9))

    async def _enter(self) -> None:
        request = pb.RegisterHostRequest(
            request_id=self.world.random_source.randbytes(16),
            host_id=self.identity.host_id,
            name=self.identity.name,
            gatekeepers=[directory_pb2.Endpoint(target="localhost:1")],
            boot_incarnation=self.identity.boot_incarnation,
            registration_epoch=self.epoch.value,
        )
        sent = self.clock.boottime_nanos()
        entered = await ask(self.world, "RegisterHost", request, 4.0, caller=self)
        self.epoch.note_registered()
        channels = map(recorded_channel, entered.channels)
        run_to_end(self.store.registering(channels, is_complete=len(entered.channels) < CHANNELS_LISTED_MAX))
        self._registered_index = entered.registered_index
        self._granted(sent, entered.lease_ttl_nanos)

    async def _renew(self) -> None:
        request = pb.RenewHostLeaseRequest(
            host_id=self.identity.host_id, boot_incarnation=self.identity.boot_incarnation,
            registered_index=self._registered_index,
        )  # fmt: skip
        sent = self.clock.boottime_nanos()
        renewed = await ask(self.world, "RenewHostLease", request, 0.7, caller=self)
        self._granted(sent, renewed.lease_ttl_nanos)

    def _granted(self, sent: int, ttl_nanos: int) -> None:
        self.lease.granted(sent_nanos=sent, ttl_nanos=ttl_nanos)
        for one in self.store.all():
            self._ownership.check(one.record.channel_id)
