"""Hosts with leases around a directory, in virtual time. They run the product's code of replicas, take-overs and moves.

Hosts die, come back without items, stop and go on; links and the way to the directory break. The leader of the
directory may change. Then the directory begins all leases anew, although a lease may have ended by its host's clock.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Coroutine, Iterator
from typing import Any, ClassVar, Protocol

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_supernode.codecs.record_codec import channel_record
from stampede_rt_supernode.core.cluster.feature_levels import MOVES_LEVEL
from stampede_rt_supernode.core.commands import Operation
from stampede_rt_supernode.core.records import ChannelRecord
from stampede_rt_supernode.core.replicas.copied_subjects import Copied, known_copied_by_id
from stampede_rt_supernode.core.replicas.copied_subjects import id_of as id_of_subject
from tests.robustness.moves.two_hosts import Host, World, key_of
from tests.support.supernode.operations import Log, expire, id_of, open_channel, register
from tests.support.virtual_time import VirtualClock

TTL_S, FENCE_S, RENEWAL_S, CHECK_S = 5.0, 4.0, 1.5, 0.5
ANSWER_SECONDS_MAX = 0.03  # to or from the directory, one way
WAY_SECONDS_MAX = 0.005  # between two hosts


class StreamEnds(Protocol):
    """A stream from `caller` to `source`; `caller` None: from a client."""

    source: Host
    caller: Host | None

    def cut(self) -> None:
        """Break the stream."""


class LeasedHost(Host):
    """A host that renews its lease. It stops serving FENCE_S after it sent the last renewal."""

    fence_s = 0.0
    _was_held = False

    def holds_lease(self) -> bool:
        return self.alive and self.cluster.clock.now_s < self.fence_s

    @property
    def cluster(self) -> Cluster:
        assert isinstance(self.world, Cluster)
        return self.world

    def background(self) -> tuple[Coroutine[Any, Any, None], ...]:
        """The work that the host does until it dies."""
        return self.keep_lease(), self.keep_fence()

    async def registered(self) -> None:
        """Process the answer to a registration."""
        await self.store.scheduler.do(self.store.registering(self.cluster.owned_by(self), is_complete=True))

    def fence(self) -> None:
        """End all waits, because the lease has run out."""
        self.store.fence()

    async def keep_lease(self) -> None:
        """Renew the lease, or register again, until the host dies."""
        while True:
            sent_s = self.cluster.clock.now_s
            try:
                await self.cluster.pass_through(self)
                if not self.cluster.renew(self):
                    self.cluster.enroll(self)
                    await self.registered()
                await self.cluster.pass_through(self)
                self.fence_s = sent_s + FENCE_S
            except Unavailable:
                pass
            await asyncio.sleep(RENEWAL_S)

    async def keep_fence(self) -> None:
        """End all waits when the lease has run out."""
        while True:
            await asyncio.sleep(0.05)
            await self.running.wait()
            is_held = self.holds_lease()
            if self._was_held and not is_held:
                self.fence()
            self._was_held = is_held


class Cluster(World):
    """The directory, `count` hosts, and one channel with this policy."""

    host_type: ClassVar[type[LeasedHost]] = LeasedHost

    def __init__(self, clock: VirtualClock, seed: int, count: int, policy: Policy) -> None:
        self.clock, self.rng = clock, random.Random(seed)
        self.crash_at, self.happens, self.reached = "", lambda world: None, []
        self.log = Log(level=MOVES_LEVEL)
        self.is_cut_off = False
        self.commits, self.channels_per_entry_max = {}, 0
        self.links: list[Any] = []
        self.cut_off: set[int] = set()  # hosts that do not reach the directory
        self.cut_pairs: set[frozenset[int]] = set()  # hosts that do not reach each other
        self.slow_s: dict[int, float] = {}  # by host: the least time that a message takes over one of its links
        self.boots = dict.fromkeys(range(1, count + 1), 0)
        self.renewed_s: dict[int, float] = {}
        self.hosts: dict[int, Any] = {}
        self.background: dict[int, list[asyncio.Task[Any]]] = {}
        self.incarnations: dict[bytes, list[int]] = {}  # for each channel or queue
        self.defects: list[BaseException] = []  # the exceptions of tasks that must not fail
        for number in self.boots:
            self.start(number)
        self._open(policy)
        self.background[0] = [asyncio.create_task(self._end_leases())]
        self._note()

    def _open(self, policy: Policy) -> None:
        named = {"max_items": 100_000, "replicas": policy.replicas, "min_replicas": policy.min_replicas}
        self.log.apply(open_channel("cam", ack=policy.ack, **named))
        self.channel_id = next(iter(self.log.directory.tables.channels))

    # The directory.

    def copied(self) -> list[Copied]:
        """The channels or queues with replicas."""
        return [*self.log.directory.tables.channels.values()]

    @property
    def channel(self) -> ChannelRecord:
        return self.log.directory.tables.channels[self.channel_id]

    def renew(self, host: Host) -> bool:
        """Whether the directory has renewed the lease."""
        known = self.log.directory.tables.hosts.get(host.identity.host_id)
        if known is None or not known.alive or known.boot_incarnation != host.identity.boot_incarnation:
            return False
        self.renewed_s[self._number(host.identity.host_id)] = self.clock.now_s
        return True

    def enroll(self, host: Host) -> None:
        """Register the host."""
        number = self._number(host.identity.host_id)
        boot = host.identity.boot_incarnation
        self.apply(register(number, boot=boot, incarnation=self.rng.getrandbits(63), move_key=key_of(number)))
        host.registered_index = self.log.directory.tables.hosts[host.identity.host_id].registered_index
        self.renewed_s[number] = self.clock.now_s

    def owned_by(self, host: Host) -> list[Any]:
        return [
            recorded_channel(channel_record(one))
            for one in self.log.directory.tables.channels_at(host.identity.host_id)
        ]

    async def _end_leases(self) -> None:
        while True:
            await asyncio.sleep(CHECK_S)
            if not self.is_cut_off:
                for known in [*self.log.directory.tables.live_hosts()]:
                    number = self._number(known.host_id)
                    if self.clock.now_s - self.renewed_s[number] > TTL_S:
                        boot, at = known.boot_incarnation, known.registered_index
                        self.apply(expire(number, boot=boot, registered_index=at))

    def another_leader(self) -> None:
        """Another supernode leads, and begins all leases anew."""
        self.renewed_s = dict.fromkeys(self.renewed_s, self.clock.now_s)

    def apply(self, operation: Operation) -> Any:
        before = [(one, [*self.successors(id_of_subject(one))]) for one in self.copied()]
        try:
            return super().apply(operation)
        finally:
            for thing, successors in before:
                self._check_successor(thing, successors)
            self._note()

    def successors(self, subject_id: bytes) -> Iterator[bytes]:
        """The hosts that must go on with the channel or queue if its owner is lost."""
        tables = self.log.directory.tables
        for one in tables.replicas.of(subject_id):
            host = tables.hosts[one.host_id]
            if one.in_sync and host.alive and host.boot_incarnation == one.boot_incarnation:
                yield one.host_id

    def is_complete(self, replicas: int) -> bool:
        """Whether each channel or queue has this number of replicas in sync."""
        return all(len([*self.successors(id_of_subject(one))]) == replicas for one in self.copied())

    def _check_successor(self, before: Copied, successors: list[bytes]) -> None:
        after = known_copied_by_id(self.log.directory.tables, id_of_subject(before))
        if successors and before.incarnation != after.incarnation:
            assert after.host_id in successors, "a replica was in sync, but another host became the owner"
            ack = before.policy.ack if isinstance(before, ChannelRecord) else before.spec.ack
            assert ack != "replica", "the incarnation has changed, although nothing was lost"
            assert after.incarnation == (before.incarnation + 1) % 2**64

    def _note(self) -> None:
        for one in self.copied():
            known = self.incarnations.setdefault(id_of_subject(one), [])
            if one.incarnation not in known[-1:]:
                known.append(one.incarnation)

    # The hosts.

    def start(self, number: int) -> None:
        """Start a host, which has no items."""
        self.boots[number] += 1
        host = self.hosts[number] = self.host_type(self, number, self.boots[number])
        self.enroll(host)
        host.fence_s = self.clock.now_s + FENCE_S
        self.background[number] = [asyncio.create_task(one) for one in host.background()]

    def kill(self, number: int) -> None:
        super().kill(number)
        self.hosts[number].running.set()
        for task in self.background[number]:
            task.cancel()

    def cut(self, one: int, other: int) -> None:
        """Break the streams between two hosts, and let no new one begin."""
        self.cut_pairs.add(frozenset((one, other)))
        for link in self.links:
            if not self.reaches(link):
                link.cut()

    def reaches(self, link: StreamEnds) -> bool:
        return frozenset(self._ends(link)) not in self.cut_pairs

    def delay_s(self, link: StreamEnds) -> float:
        slow_s = (self.slow_s.get(one, 0.0) for one in self._ends(link))
        return max(self.rng.uniform(0, WAY_SECONDS_MAX), *slow_s)

    def _ends(self, link: StreamEnds) -> list[int]:
        """The numbers of the hosts at both ends; 0 for a client."""
        return [0 if one is None else self._number(one.identity.host_id) for one in (link.source, link.caller)]

    async def on_the_way(self, host: Host) -> None:
        await asyncio.sleep(self.rng.uniform(0, ANSWER_SECONDS_MAX))
        await host.running.wait()
        if self._number(host.identity.host_id) in self.cut_off:
            raise Unavailable("the way to the directory is cut")

    async def pass_through(self, host: Host) -> None:
        """Wait while a call is on its way. Raises Unavailable if it does not arrive."""
        await self.on_the_way(host)
        if self.is_cut_off or not host.alive:
            raise Unavailable("no supernode can be reached")

    def _number(self, host_id: bytes) -> int:
        return int.from_bytes(host_id, "big")

    def heal(self) -> None:
        """End all faults."""
        self.is_cut_off = False
        self.cut_off.clear()
        self.cut_pairs.clear()
        self.slow_s.clear()
        for number, host in self.hosts.items():
            host.running.set()
            if not host.alive:
                self.start(number)

    async def aclose(self) -> None:
        """End all work of the hosts."""
        for number in self.boots:
            if self.hosts[number].alive:
                self.kill(number)
        self.background[0][0].cancel()
        await asyncio.sleep(0)


def serving(cluster: Cluster, channel_id: bytes) -> list[int]:
    """The hosts that serve the channel, at any epoch.

    Leaves out a former owner that has not learned of a commit. It holds the channel and accepts no items, so its
    readers see only items that the new owner has, too.
    """
    found: dict[int, int] = {}
    held = set()
    for number, host in cluster.hosts.items():
        hosted = host.store.known(channel_id)
        if hosted is None or hosted.copy is not None or not host.running.is_set():
            continue
        try:
            host.store.find(channel_id, hosted.epoch)
        except StampedeError:
            continue
        found[number] = hosted.epoch
        if hosted.moving is not None and hosted.moving.is_held:
            held.add(number)
    newest = max(found.values(), default=0)
    return [number for number, epoch in found.items() if epoch == newest or number not in held]


__all__ = ["Cluster", "LeasedHost", "id_of", "serving"]
