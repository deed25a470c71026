"""After any commands, each name has at most one live peer, this peer has one mailbox, and each queue has one owner."""

from __future__ import annotations

import os
from typing import TypeVar

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import initialize, invariant, rule

from stampede_rt_supernode.core.commands import RefusedOperation, Result
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerRegistered,
    PeersExpired,
    RegisterPeer,
)
from stampede_rt_supernode.core.records import ChangeKind, DirectoryChange, PeerRecord, QueueRecord
from tests.support.supernode.drawn_peers import endings, queue_operations, registrations
from tests.support.supernode.operations import begin_tenure, deregister, open_queue, register
from tests.support.supernode.three_directories import ThreeDirectories

T = TypeVar("T")


class LivePeers:
    """The live peers, computed from requests and answers only: the oracle for the directory's peers."""

    def __init__(self) -> None:
        self.living: dict[bytes, RegisterPeer] = {}
        self.registered: dict[bytes, int] = {}

    def register(self, operation: RegisterPeer, result: Result) -> None:
        displaced = [
            one for one in self.living.values() if one.peer_id == operation.peer_id or one.name == operation.name != ""
        ]
        may = all(self._may_displace(one, operation) for one in displaced)
        if isinstance(result, PeerRegistered):
            assert may, "a live peer lost its place to a peer without its proof"
            for one in displaced:
                del self.living[one.peer_id]
            self.living[operation.peer_id] = operation
            self.registered[operation.peer_id] = result.peer.registered_index
        elif isinstance(result, RefusedOperation):
            assert not (may and result.reason == "PEER_EXISTS"), "a peer was refused a place that was its own"

    def end(self, operation: DeregisterPeer | ExpirePeers, tenure: int) -> set[bytes]:
        """End the registrations that `operation` names. Returns the ids of their peers."""
        if isinstance(operation, DeregisterPeer):
            boots = {(operation.peer_id, operation.boot_incarnation, self.registered.get(operation.peer_id))}
        else:
            boots = {(one.peer_id, one.boot_incarnation, one.registered_index) for one in operation.leases}
        if isinstance(operation, ExpirePeers) and operation.tenure != tenure:
            return set()
        held = self.living.items()
        gone = {one for one, entry in held if (one, entry.boot_incarnation, self.registered[one]) in boots}
        for one in gone:
            del self.living[one]
        return gone

    @staticmethod
    def _may_displace(one: RegisterPeer, operation: RegisterPeer) -> bool:
        if one.proof_sha256 or operation.proof_sha256:
            return one.proof_sha256 == operation.proof_sha256
        same_process = (one.peer_id, one.boot_incarnation) == (operation.peer_id, operation.boot_incarnation)
        return same_process or not one.name


class PeerMachine(ThreeDirectories):
    """Queues, mailboxes and peers, and hosts that come and go under them."""

    @initialize()
    def found(self) -> None:
        self.live_peers = LivePeers()
        self.places: dict[bytes, tuple[int, int]] = {}
        self.queues_mirror: dict[bytes, QueueRecord] = {}
        self.peers_mirror: dict[bytes, PeerRecord] = {}
        self.positions = [0, 0]
        self.apply(begin_tenure(), self.fresh_id())
        for number, name in enumerate(("a", "b"), start=1):
            self.apply(register(number, name=name), self.fresh_id())
        self.apply(open_queue("x"), self.fresh_id())

    @rule(data=st.data())
    def change_queue(self, data: st.DataObject) -> None:
        self.apply(data.draw(queue_operations(self.directory, self.fresh_id())), self.fresh_id())

    @rule(data=st.data(), is_repeated=st.sampled_from([False, False, True]))
    def register_peer(self, data: st.DataObject, is_repeated: bool) -> None:
        operation, op_id = data.draw(registrations(self.directory, self.fresh_id())), self.fresh_id()
        result = self.apply(operation, op_id)
        self.live_peers.register(operation, result)
        if is_repeated and isinstance(result, PeerRegistered):
            assert self.apply(operation, op_id) == result, "a repeated request is answered and not performed"

    @rule(data=st.data())
    def end_peers(self, data: st.DataObject) -> None:
        operation = data.draw(endings(self.directory))
        before = dict(self.directory.tables.peers.by_id)
        gone = self.live_peers.end(operation, self.directory.tenure)
        result = self.apply(operation, self.fresh_id())
        if isinstance(result, PeersExpired):
            assert result.expired == len(gone)
            assert all(self.directory.tables.peers.by_id[one].name == before[one].name for one in gone)

    @rule(number=st.integers(1, 3), boot=st.integers(1, 2), leaves=st.booleans())
    def change_host(self, number: int, boot: int, leaves: bool) -> None:
        name = "abc"[number - 1]
        operation = deregister(number, boot=boot) if leaves else register(number, name=name, boot=boot)
        self.apply(operation, self.fresh_id())

    @invariant()
    def the_living_are_those_that_the_answers_told_of(self) -> None:
        tables = self.directory.tables
        operations = self.live_peers.living
        living = {one: (operation.name, operation.boot_incarnation) for one, operation in operations.items()}
        assert {one.peer_id: (one.name, one.boot_incarnation) for one in tables.peers.live()} == living
        assert dict(tables.peers.ids) == {name: one for one, (name, _) in living.items() if name}
        assert len(tables.peers.ids) == sum(bool(name) for name, _ in living.values()), "a name has one live owner"
        assert tables.peers.live_count == len(living)
        assert len(tables.peers.keys) == len(tables.peers)

    @invariant()
    def a_peer_has_a_mailbox_if_and_only_if_it_lives_and_has_a_name(self) -> None:
        tables = self.directory.tables
        boxes = {one.mailbox_peer_id: one.queue_id for one in tables.queues.by_id.values() if one.mailbox_peer_id}
        assert boxes == {
            one.peer_id: one.mailbox_queue_id for one in tables.peers.by_id.values() if one.mailbox_queue_id
        }
        assert set(boxes) == set(tables.peers.ids.values())
        assert len(boxes) == len(tables.queues) - len(tables.queues.ids)

    @invariant()
    def queues_are_where_they_are_counted_and_lost_hosts_with_nothing_are_forgotten(self) -> None:
        tables = self.directory.tables
        queues = tables.queues
        assert dict(queues.ids) == {one.name: one.queue_id for one in queues.by_id.values() if not one.mailbox_peer_id}
        for host_id, host in tables.hosts.items():
            owned = sorted(one.queue_id for one in queues.by_id.values() if one.host_id == host_id)
            assert [one.queue_id for one in queues.at(host_id)] == owned
            assert host.alive or owned
        assert {one.host_id for one in queues.by_id.values()} <= set(tables.hosts)

    @invariant()
    def a_mailbox_is_at_a_live_host_if_there_is_any(self) -> None:
        tables = self.directory.tables
        boxes = [one for one in tables.queues.by_id.values() if one.mailbox_peer_id]
        assert all(tables.hosts[one.host_id].alive for one in boxes) or not tables.host_ids

    @invariant()
    def dead_letters_end_somewhere(self) -> None:
        queues = self.directory.tables.queues
        feeding: dict[bytes, set[bytes]] = {}
        for queue in queues.by_id.values():
            at, steps = queue.spec.dead_letter_queue_id, 0
            if at is not None:
                feeding.setdefault(at, set()).add(queue.queue_id)
            while at is not None:
                steps += 1
                assert steps <= len(queues)
                assert not queues.by_id[at].mailbox_peer_id
                at = queues.by_id[at].spec.dead_letter_queue_id
        assert {one: {other.queue_id for other in queues.feeding(one)} for one in queues.by_id} == {
            one: feeding.get(one, set()) for one in queues.by_id
        }

    @invariant()
    def an_epoch_never_falls_and_an_incarnation_changes_only_with_it(self) -> None:
        now = {one: (queue.epoch, queue.incarnation) for one, queue in self.directory.tables.queues.by_id.items()}
        for one, (epoch, incarnation) in now.items():
            held_epoch, held_incarnation = self.places.get(one, (epoch, incarnation))
            assert epoch >= held_epoch
            assert (epoch == held_epoch) == (incarnation == held_incarnation) or epoch > held_epoch + 1
            assert incarnation != 0
        self.places |= now

    @invariant()
    def a_watcher_that_follows_the_changes_sees_queues_and_peers_as_they_are(self) -> None:
        tables = self.directory.tables
        for place, ring in enumerate((tables.changes, tables.peers.changes)):
            page = ring.read(self.positions[place], 10_000)
            assert page is not None
            self.positions[place] = page.position
            for change in page.changes:
                self.follow(change)
        assert self.queues_mirror == tables.queues.by_id
        assert self.peers_mirror == tables.peers.by_id

    def follow(self, change: DirectoryChange) -> None:
        match change.subject:
            case QueueRecord() as queue:
                self.put(self.queues_mirror, queue.queue_id, queue, change.kind)
            case PeerRecord() as peer:
                self.put(self.peers_mirror, peer.peer_id, peer, change.kind)

    @staticmethod
    def put(mirror: dict[bytes, T], one: bytes, value: T, kind: ChangeKind) -> None:
        assert (one in mirror) == (kind is not ChangeKind.ADDED)
        if kind is ChangeKind.REMOVED:
            del mirror[one]
        else:
            mirror[one] = value


TestPeers = PeerMachine.TestCase
TestPeers.settings = settings(
    max_examples=int(os.environ.get("STAMPEDE_PROPERTY_EXAMPLES", "25")), stateful_step_count=30
)
