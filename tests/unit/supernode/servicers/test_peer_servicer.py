"""Peers over gRPC: registration, leases, discovery and watching."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator
from typing import Any

import pytest
import pytest_asyncio

from stampede_rt.v1 import directory_pb2, peer_pb2
from stampede_rt.v1 import peer_service_pb2 as pb
from stampede_rt.v1 import queue_directory_service_pb2 as queues_pb
from stampede_rt_supernode.core import lease
from stampede_rt_supernode.core.records import PeerRecord
from stampede_rt_supernode.servicers import followed_peers, lease_keeper
from tests.support.supernode.node import Node, reason_of, running_node
from tests.support.supernode.operations import TTL_NANOS, id_of

PROOF, OTHER_PROOF = b"p" * 32, b"q" * 32


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1, name="one")
        yield node


_numbers = iter(range(1000, 10**6))


def entering(number: int, name: str = "", *, boot: int = 1, **fields: Any) -> pb.RegisterPeerRequest:
    return pb.RegisterPeerRequest(
        request_id=id_of(next(_numbers)),
        peer_id=id_of(number),
        name=name,
        boot_incarnation=boot,
        registration_epoch=boot - 1,
        **fields,
    )


def renewal(number: int, *, boot: int = 1, **fields: Any) -> pb.RenewPeerLeaseRequest:
    return pb.RenewPeerLeaseRequest(peer_id=id_of(number), boot_incarnation=boot, **fields)


def leaving(number: int, *, boot: int = 1) -> pb.DeregisterPeerRequest:
    return pb.DeregisterPeerRequest(request_id=id_of(next(_numbers)), peer_id=id_of(number), boot_incarnation=boot)


async def seconds_with_the_host(node: Node, seconds: int, *peers: int) -> None:
    """Let the time pass. Each second the host and these peers renew their leases."""
    for _ in range(seconds):
        await node.renew(1)
        for peer in peers:
            await Node.call(node.peers.RenewPeerLease(renewal(peer)))
        await node.pass_seconds(1)


async def test_a_peer_can_register_be_found_and_leave(node: Node) -> None:
    registered = await node.peers.RegisterPeer(
        entering(7, "planner", host_id=id_of(1), zone="lab", version="1.2", attributes={"role": "driver"})
    )
    peer = registered.peer
    assert (peer.name, peer.alive, peer.zone, peer.version, peer.host_id) == ("planner", True, "lab", "1.2", id_of(1))
    assert dict(peer.attributes) == {"role": "driver"}
    assert peer.registered_unix_nano == node.clock.time_unix_nano()
    assert (registered.lease_ttl_nanos, bool(registered.cluster_id)) == (TTL_NANOS, True)
    assert (registered.mailbox.queue_id, registered.mailbox.mailbox_peer_id) == (peer.mailbox_queue_id, id_of(7))
    assert (registered.mailbox.spec.max_items, registered.mailbox_host.name) == (1024, "one")
    for key in ({"name": "planner"}, {"peer_id": id_of(7)}):
        found = await node.peers.ResolvePeer(pb.ResolvePeerRequest(**key))
        assert (found.peer, found.applied_index) == (peer, node.log.index)
    by_peer = queues_pb.ResolveQueueRequest(peer_name="planner")
    assert (await node.queues.ResolveQueue(by_peer)).queue == registered.mailbox
    await node.peers.DeregisterPeer(leaving(7))
    error = await reason_of(node.peers.ResolvePeer(pb.ResolvePeerRequest(name="planner")))
    assert (error.reason, error.metadata["peer"]) == ("PEER_NOT_FOUND", "planner")
    error = await reason_of(node.queues.ResolveQueue(by_peer))
    assert (error.reason, error.metadata["peer"]) == ("QUEUE_NOT_FOUND", "planner")


async def test_a_second_peer_with_the_name_of_a_live_one_needs_the_proof(node: Node) -> None:
    first = await node.peers.RegisterPeer(entering(7, "planner", proof=PROOF))
    error = await reason_of(node.peers.RegisterPeer(entering(8, "planner", proof=OTHER_PROOF)))
    assert (error.reason, error.metadata["peer"]) == ("PEER_EXISTS", "planner")
    second = await node.peers.RegisterPeer(entering(9, "planner", boot=2, proof=PROOF))
    assert (second.mailbox_kept, second.mailbox.queue_id) == (True, first.mailbox.queue_id)
    assert second.mailbox.incarnation == first.mailbox.incarnation
    assert (await reason_of(node.peers.RenewPeerLease(renewal(7)))).reason == "LEASE_EXPIRED"
    await node.peers.RenewPeerLease(renewal(9, boot=2))


async def test_a_proof_of_another_length_is_refused(node: Node) -> None:
    error = await reason_of(node.peers.RegisterPeer(entering(7, "planner", proof=b"short")))
    assert (error.reason, error.metadata["field"]) == ("INVALID_ARGUMENT", "proof")


async def test_the_directory_never_holds_a_proof(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner", proof=PROOF))
    assert PROOF not in node.replica.begin_snapshot()()


async def test_renewals_keep_a_lease_without_an_entry_in_the_log_and_without_them_it_ends(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner"))
    await node.peers.RegisterPeer(entering(8, "driver"))
    index = node.log.index
    renewed = await node.peers.RenewPeerLease(renewal(7))
    assert (renewed.lease_ttl_nanos, renewed.tenure) == (TTL_NANOS, 1)
    await seconds_with_the_host(node, 4, 7)
    assert node.log.index == index
    await seconds_with_the_host(node, 2, 7)
    listed = await node.peers.ListPeers(pb.ListPeersRequest())
    assert [peer.name for peer in listed.peers] == ["planner"]
    assert node.log.index == index + 1
    assert (await reason_of(node.peers.RenewPeerLease(renewal(8)))).reason == "LEASE_EXPIRED"
    gone = (await node.peers.ResolvePeer(pb.ResolvePeerRequest(peer_id=id_of(8)))).peer
    assert (gone.alive, gone.HasField("mailbox_queue_id")) == (False, False)


async def test_many_leases_that_end_together_cost_few_entries_in_the_log(node: Node) -> None:
    for number in range(300):
        await node.peers.RegisterPeer(entering(5000 + number))
    index = node.log.index
    await seconds_with_the_host(node, 7)
    assert len((await node.peers.ListPeers(pb.ListPeersRequest())).peers) == 0
    assert node.log.index <= index + 3


async def test_a_new_leader_grants_peers_a_full_lease(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner"))
    await seconds_with_the_host(node, 4)
    node.log.tenure = 2
    await node.leases.tick()
    await seconds_with_the_host(node, 4)
    await node.peers.RenewPeerLease(renewal(7))


async def test_a_leader_updates_leases_after_changes_of_peers_a_few_in_each_turn(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, each peer that came or left cost the leader 0.1 s if there were 100,000 peers."""
    monkeypatch.setattr(followed_peers, "PEERS_PER_TURN", 4)
    noted: list[int] = []
    note, turn = lease.LeaseTable.note, 0

    def counted(table: lease.LeaseTable, holder: lease.RegisteredHolder, now: int) -> object:
        if isinstance(holder, PeerRecord):
            noted.append(turn)
        return note(table, holder, now)

    async def let_others_run() -> None:
        nonlocal turn
        turn += 1

    monkeypatch.setattr(lease.LeaseTable, "note", counted)
    monkeypatch.setattr(lease_keeper.LeaseKeeper, "_let_others_run", staticmethod(let_others_run))
    for number in range(30):
        await node.peers.RegisterPeer(entering(5000 + number))
    await node.leases.tick()
    assert len(noted) == 30
    assert max(Counter(noted).values()) <= 4
    noted.clear()
    await node.peers.RegisterPeer(entering(6000))
    await node.leases.tick()
    await node.leases.tick()
    assert len(noted) == 1
    noted.clear()
    node.replica.prepare_restore(node.replica.begin_snapshot()())()  # the watch knows no changes of the restored state
    await node.leases.tick()
    assert len(noted) == 31


async def test_only_the_leader_renews_leases_of_peers(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7))
    node.log.leader_id = "s2"
    error = await reason_of(node.peers.RenewPeerLease(renewal(7)))
    assert (error.reason, error.metadata["leader"]) == ("NOT_LEADER", "s2")


async def test_another_boot_can_neither_renew_nor_leave(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner"))
    assert (await reason_of(node.peers.RenewPeerLease(renewal(7, boot=2)))).reason == "LEASE_EXPIRED"
    assert (await reason_of(node.peers.DeregisterPeer(leaving(7, boot=2)))).reason == "LEASE_EXPIRED"
    await node.peers.DeregisterPeer(leaving(99))  # a peer that is not registered counts as having left


async def test_peers_are_listed_by_name_and_peers_without_a_name_last(node: Node) -> None:
    for number, name in ((5, "b"), (6, "a"), (4, ""), (3, ""), (9, "a/x")):
        await node.peers.RegisterPeer(entering(number, name))
    names, token = [], ""
    for _ in range(3):
        page = await node.peers.ListPeers(pb.ListPeersRequest(page_size=2, page_token=token))
        names += [peer.name or peer.peer_id for peer in page.peers]
        token = page.next_page_token
    assert (names, token) == (["a", "a/x", "b", id_of(3), id_of(4)], "")
    some = await node.peers.ListPeers(pb.ListPeersRequest(name_glob="a*"))
    assert [peer.name for peer in some.peers] == ["a", "a/x"]
    page = await node.peers.ListPeers(pb.ListPeersRequest(page_size=2))
    other = pb.ListPeersRequest(name_glob="*", page_token=page.next_page_token)
    assert (await reason_of(node.peers.ListPeers(other))).reason == "INVALID_ARGUMENT"


async def test_peers_without_a_lease_are_listed_on_request(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner"))
    await seconds_with_the_host(node, 6)
    await node.peers.RegisterPeer(entering(8, "planner"))
    assert [peer.alive for peer in (await node.peers.ListPeers(pb.ListPeersRequest())).peers] == [True]
    both = await node.peers.ListPeers(pb.ListPeersRequest(include_dead=True))
    assert [(peer.peer_id, peer.alive) for peer in both.peers] == [(id_of(7), False), (id_of(8), True)]


async def test_a_watch_of_peers_has_every_change_and_continues_where_another_one_ended(node: Node) -> None:
    watch = node.peers.WatchPeers(pb.WatchPeersRequest())
    begin = (await watch.read()).applied_index
    await node.peers.RegisterPeer(entering(7, "planner"))
    await node.open("cam")  # a channel is no peer
    await node.peers.RegisterPeer(entering(8))
    await node.peers.DeregisterPeer(leaving(7))
    seen = await _changes(watch, 3)
    added, removed = directory_pb2.CHANGE_KIND_ADDED, directory_pb2.CHANGE_KIND_REMOVED
    assert [(change.kind, change.peer.peer_id) for change in seen] == [
        (added, id_of(7)),
        (added, id_of(8)),
        (removed, id_of(7)),
    ]
    resumed = node.peers.WatchPeers(pb.WatchPeersRequest(after_index=begin))
    assert await _changes(resumed, 3) == seen
    named = node.peers.WatchPeers(pb.WatchPeersRequest(name_glob="p*", after_index=begin))
    assert [change.peer.name for change in await _changes(named, 2)] == ["planner", "planner"]
    for one in (watch, resumed, named):
        one.cancel()


async def _changes(watch: Any, count: int) -> list[peer_pb2.PeerChange]:
    seen: list[peer_pb2.PeerChange] = []
    while len(seen) < count:
        seen += (await watch.read()).changes
    return seen


async def test_a_watch_from_a_forgotten_index_is_refused(node: Node) -> None:
    watch = node.peers.WatchPeers(pb.WatchPeersRequest(after_index=node.log.index + 1))
    assert (await reason_of(watch.read())).reason == "WATCH_RESTART"


async def test_a_peer_with_a_name_needs_a_host_for_its_mailbox_and_one_without_a_name_does_not() -> None:
    async with running_node() as node:
        assert (await reason_of(node.peers.RegisterPeer(entering(7, "planner")))).reason == "NO_HOST"
        registered = await node.peers.RegisterPeer(entering(7))
        assert not registered.HasField("mailbox")


BEHIND = peer_pb2.ClockOffset(offset_nanos=-80_000_000, uncertainty_nanos=500_000, supernode_id="s1")
AHEAD = peer_pb2.ClockOffset(offset_nanos=30_000_000, uncertainty_nanos=700_000, supernode_id="s1")


async def clocks(node: Node, **fields: Any) -> dict[str, peer_pb2.ClockOffset | None]:
    """The clock offsets by the names of the peers; None: unknown."""
    listed = await Node.call(node.peers.ListPeers(pb.ListPeersRequest(with_clocks=True, **fields)))
    return {peer.name: peer.clock if peer.HasField("clock") else None for peer in listed.peers}


async def test_the_leader_gives_the_reported_clocks_of_peers_only_on_request(node: Node) -> None:
    registered = await node.peers.RegisterPeer(entering(7, "planner", clock=BEHIND))
    await node.peers.RegisterPeer(entering(8, "older"))
    assert await clocks(node) == {"older": None, "planner": BEHIND}
    await node.peers.RenewPeerLease(renewal(7, clock=AHEAD))
    assert await clocks(node) == {"older": None, "planner": AHEAD}
    found = await node.peers.ResolvePeer(pb.ResolvePeerRequest(name="planner", with_clocks=True))
    assert found.peer.clock == AHEAD
    unasked = await node.peers.ResolvePeer(pb.ResolvePeerRequest(name="planner"))
    assert unasked.peer == registered.peer
    assert not any(peer.HasField("clock") for peer in (await node.peers.ListPeers(pb.ListPeersRequest())).peers)


async def test_the_clocks_of_peers_are_in_no_log_and_no_snapshot(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner"))
    index, snapshot = node.log.index, node.replica.begin_snapshot()()
    await node.peers.RenewPeerLease(renewal(7, clock=BEHIND))
    assert await clocks(node) == {"planner": BEHIND}
    assert (node.log.index, node.replica.begin_snapshot()()) == (index, snapshot)


async def test_a_renewal_has_the_time_of_the_leader_and_how_long_the_leader_held_it(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7))
    node.log.reads_may_end.clear()
    node.log.read_waits.clear()
    renewing = node.peers.RenewPeerLease(renewal(7))
    await node.log.read_waits.wait()
    node.clock.advance(3_000_000)
    node.log.reads_may_end.set()
    renewed = await renewing
    assert (renewed.supernode_id, renewed.time_unix_nano) == ("s1", node.clock.time_unix_nano())
    assert renewed.held_nanos == 3_000_000


async def test_a_new_leader_knows_only_clocks_reported_to_it_and_a_follower_names_the_leader(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner", clock=BEHIND))
    node.log.tenure = 2
    await node.leases.tick()
    assert await clocks(node) == {"planner": None}
    await node.peers.RenewPeerLease(renewal(7, clock=AHEAD))
    assert await clocks(node) == {"planner": AHEAD}
    node.log.leader_id = "s2"
    assert (await reason_of(clocks(node, stale_ok=True))).metadata["leader"] == "s2"
    lookup = pb.ResolvePeerRequest(name="planner", with_clocks=True)
    assert (await reason_of(node.peers.ResolvePeer(lookup))).reason == "NOT_LEADER"
    await node.leases.tick()
    await node.peers.RegisterPeer(entering(8, "late", clock=BEHIND))  # at a follower, which ignores the clock
    node.log.leader_id, node.log.tenure = "s1", 3
    await node.leases.tick()
    assert await clocks(node) == {"late": None, "planner": None}


async def test_the_clock_of_a_peer_is_removed_with_its_lease_and_its_registration(node: Node) -> None:
    await node.peers.RegisterPeer(entering(7, "planner", proof=PROOF, clock=BEHIND))
    await node.peers.RegisterPeer(entering(7, "planner", boot=2, proof=PROOF))
    assert await clocks(node) == {"planner": None}
    await node.peers.RenewPeerLease(renewal(7, boot=2, clock=AHEAD))
    await seconds_with_the_host(node, 6)
    assert await clocks(node, include_dead=True) == {"planner": None}


async def test_impossible_facts_of_a_clock_are_refused(node: Node) -> None:
    for wrong in (
        peer_pb2.ClockOffset(offset_nanos=1, uncertainty_nanos=-1, supernode_id="s1"),
        peer_pb2.ClockOffset(offset_nanos=1, uncertainty_nanos=1),
        peer_pb2.ClockOffset(offset_nanos=1, uncertainty_nanos=1, supernode_id="s" * 129),
    ):
        error = await reason_of(node.peers.RegisterPeer(entering(7, "planner", clock=wrong)))
        assert (error.reason, "clock." in error.message) == ("INVALID_ARGUMENT", True)
        assert (await reason_of(node.peers.RenewPeerLease(renewal(7, clock=wrong)))).reason == "INVALID_ARGUMENT"
