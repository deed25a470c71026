"""Peers in simulated time.

Each peer wants one of a few names, keeps its lease, and believes that no other peer has its name.
"""

from __future__ import annotations

import itertools
from typing import Any

from stampede_rt.cluster.registration_epoch import RegistrationEpoch
from stampede_rt.errors import LeaseExpired, StaleRegistration, StampedeError
from stampede_rt.v1 import peer_service_pb2 as pb
from stampede_rt_channel_host.cluster.host_lease import HostLease
from stampede_rt_supernode.core.directory import Directory
from tests.robustness.directory.asking import ask
from tests.robustness.directory.tasks import drive
from tests.robustness.directory.world import Clock, DirectoryWorld
from tests.support.supernode.list_machine import PromiseBroken

NAMES = ("planner", "driver")


class NameOwnership:
    """The rule that at each moment of true time at most one peer believes that it has a name. Checks all peers."""

    def __init__(self, world: DirectoryWorld) -> None:
        self.peers: list[SimPeer] = []
        self.grants = 0
        self._world = world

    def granted(self, name: str) -> None:
        """Note that a peer got the name. Raises PromiseBroken if another peer believes that it has the name."""
        self.grants += 1
        owners = [peer.number for peer in self.peers if peer.name == name and peer.believes()]
        if len(owners) > 1:
            raise PromiseBroken(f"peers {owners} all have the name {name} at one moment")
        alive: list[Any] = list(self._world.alive())
        if alive:
            self._world.random_source.choice(alive).machine.read(check_mailboxes)


def check_mailboxes(directory: Directory) -> None:
    """Check that exactly the live peers with a name have a mailbox. Raises PromiseBroken."""
    tables = directory.tables
    held = {one.mailbox_peer_id: one.queue_id for one in tables.queues.by_id.values() if one.mailbox_peer_id}
    due = {one.peer_id: one.mailbox_queue_id for one in tables.peers.live() if one.name}
    if held != due:
        raise PromiseBroken(f"the mailboxes are {held} where the live named peers have {due}")


class SimPeer:
    """One peer.

    It restarts with its proof and a new boot incarnation, and freezes. Its lease has a fence, like a host's.
    """

    def __init__(self, world: DirectoryWorld, number: int, ownership: NameOwnership) -> None:
        self.world, self.number, self._ownership = world, number, ownership
        self._peer_id, self._proof = (100 + number).to_bytes(16, "big"), bytes([number + 1]) * 32
        self._boots = itertools.count(1)
        self.clock = Clock(world)
        self.frozen_until = 0.0
        ownership.peers.append(self)
        world.counts_on_lease[self._peer_id] = lambda boot: boot == self.boot and self.believes()
        self.restart()

    def restart(self) -> None:
        """Kill and start the peer. It keeps its id and proof."""
        self.boot = 1000 * (self.number + 1) + next(self._boots)
        self.name = self.world.random_source.choice(NAMES)
        self.lease, self.epoch = HostLease(), RegistrationEpoch()
        boot = self.boot
        drive(self._keep, alive=lambda: self.boot == boot, gate=self._when_awake)

    def believes(self) -> bool:
        """Whether it believes now that it has its name."""
        return self.lease.is_held(self.clock.boottime_nanos())

    def _when_awake(self, call: Any) -> None:
        if self.frozen_until > self.world.now:
            self.world.at(self.frozen_until + self.world.random_source.random() * 0.001, call)
        else:
            call()

    async def _keep(self) -> None:
        while True:
            try:
                if self.believes() and self.world.random_source.random() < 0.02:
                    await self._leave()
                await (self._renew() if self.believes() else self._enter())
            except LeaseExpired:
                self.lease.give_up()
            except StaleRegistration as error:
                if self.epoch.may_overtake(error):
                    continue
            except StampedeError:
                pass  # the name is taken, or no supernode answered; tried again below
            await self.world.sleep(max(0.05, self.lease.renewal_in_nanos(self.clock.boottime_nanos()) / 1e9))

    async def _enter(self) -> None:
        request = pb.RegisterPeerRequest(
            request_id=self.world.random_source.randbytes(16),
            peer_id=self._peer_id,
            name=self.name,
            boot_incarnation=self.boot,
            proof=self._proof,
            registration_epoch=self.epoch.value,
        )
        sent = self.clock.boottime_nanos()
        entered = await ask(self.world, "RegisterPeer", request, 4.0, caller=self)
        self.epoch.note_registered()
        self._granted(sent, entered.lease_ttl_nanos)

    async def _renew(self) -> None:
        request = pb.RenewPeerLeaseRequest(peer_id=self._peer_id, boot_incarnation=self.boot)
        sent = self.clock.boottime_nanos()
        renewed = await ask(self.world, "RenewPeerLease", request, 0.7, caller=self)
        self._granted(sent, renewed.lease_ttl_nanos)

    async def _leave(self) -> None:
        self.lease.give_up()
        request = pb.DeregisterPeerRequest(
            request_id=self.world.random_source.randbytes(16), peer_id=self._peer_id, boot_incarnation=self.boot
        )
        await ask(self.world, "DeregisterPeer", request, 4.0, caller=self)

    def _granted(self, sent: int, ttl_nanos: int) -> None:
        self.lease.granted(sent_nanos=sent, ttl_nanos=ttl_nanos)
        self._ownership.granted(self.name)
