"""Peers: they register by name, are found, keep their leases, leave, and return."""

from __future__ import annotations

import asyncio
import os
import sys
import threading
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.v1 import peer_service_pb2
from stampede_rt_local.cluster import LocalCluster
from tests.support.processes import started
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)

STAY = """
import sys
import stampede_rt as st
with st.connect(sys.argv[1], name=sys.argv[2], proof="0123456789abcdef") as rt:
    print("in", flush=True)
    sys.stdin.read()
"""


def names(rt: st.Connection, glob: str = "*") -> list[str]:
    return [peer.name for peer in rt.peers(glob)]


def test_a_named_connection_is_listed_while_it_is_open(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as watching:
        with st.connect(cluster.address, name="list/me", zone="lab") as rt:
            found = watching.peer("list/me")
            assert (found.name, found.alive, found.zone, rt.name) == ("list/me", True, "lab", "list/me")
            assert found.mailbox_queue_id == rt.mailbox.info.queue_id
            assert names(watching, "list/*") == ["list/me"]
        assert names(watching, "list/*") == []
        with pytest.raises(st.PeerNotFound, match="list/me"):
            watching.peer("list/me")


def test_a_connection_without_a_name_is_not_a_peer(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        before = rt.peers(include_dead=True)
        with st.connect(cluster.address) as nameless:
            assert rt.peers(include_dead=True) == before
            with pytest.raises(st.InvalidArgument, match='connect\\(name="planner"\\)'):
                _ = nameless.mailbox


def test_a_second_live_peer_of_a_name_is_refused_with_the_reason(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="only/one") as first:
        with pytest.raises(st.PeerExists, match="another live peer has the name 'only/one'"):
            st.connect(cluster.address, name="only/one")
        with pytest.raises(st.PeerExists):
            st.connect(cluster.address, name="only/one", proof="quite another proof")
        assert names(first, "only/*") == ["only/one"]
    with st.connect(cluster.address, name="only/one") as second:
        assert names(second, "only/*") == ["only/one"]


def test_a_refused_connection_leaves_no_thread_running(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="quiet"):
        with pytest.raises(st.PeerExists):
            st.connect(cluster.address, name="quiet")
        assert [thread.name for thread in threading.enumerate() if "lease of peer" in thread.name] == [
            "stampede lease of peer quiet"
        ]


def test_a_killed_peer_that_returns_with_its_proof_keeps_its_mailbox(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        with started([sys.executable, "-c", STAY, cluster.address, "phoenix"]) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "in\n"
            rt.send("phoenix", b"while it was alive")
        with pytest.raises(st.PeerExists):
            st.connect(cluster.address, name="phoenix")
        with st.connect(cluster.address, name="phoenix", proof="0123456789abcdef") as reconnected:
            message = reconnected.mailbox.get(timeout=10)
            assert message is not None
            assert message.payload == b"while it was alive"


def test_the_later_of_two_live_processes_with_one_proof_gets_the_name_and_the_other_an_error(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    """In an earlier version, the two processes took the name and the messages from each other again and again.

    When one of them ended, the name was free although the other process still lived.
    """
    proof = "0123456789abcdef"
    former = st.connect(cluster.address, name="twice", proof=proof)
    with st.connect(cluster.address) as rt, st.connect(cluster.address, name="twice", proof=proof) as latter:
        with pytest.raises(st.PeerExists, match="another process took over the name 'twice' with the same proof"):
            former.mailbox.get(timeout=30)
        with pytest.raises(st.PeerExists):
            former.mailbox.get(timeout=0)
        former.close()
        assert "could not deregister" not in caplog.text
        rt.send("twice", b"for the one that lives")
        message = latter.mailbox.get(timeout=10)
        assert message is not None
        assert message.payload == b"for the one that lives"
        message.ack()


def test_a_proof_without_a_name_is_refused(cluster: LocalCluster) -> None:
    with pytest.raises(st.InvalidArgument, match="a proof belongs to a name"):
        st.connect(cluster.address, proof="0123456789abcdef")


@pytest.mark.parametrize("proof", ["short", 7])
def test_a_proof_that_is_easy_to_guess_is_refused(cluster: LocalCluster, proof: Any) -> None:
    with pytest.raises(st.InvalidArgument, match="token_hex"):
        st.connect(cluster.address, name="weak", proof=proof)


def test_a_watch_shows_peers_that_join_and_leave(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt, rt.watch_peers("seen/*") as changes:
        with st.connect(cluster.address, name="seen/one"), st.connect(cluster.address, name="unseen/one"):
            change = next(changes)
            assert (change.kind, change.peer.name, change.peer.alive) == ("added", "seen/one", True)
        assert next(changes).kind == "removed"


async def test_peers_are_listed_refused_and_watched_with_asyncio(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address) as rt, rt.watch_peers("aio/*") as changes:
        async with aio.connect(cluster.address, name="aio/one"):
            assert [peer.name for peer in await rt.peers("aio/*")] == ["aio/one"]
            with pytest.raises(st.PeerExists):
                await aio.connect(cluster.address, name="aio/one")
        assert [(await anext(changes)).kind for _ in range(2)] == ["added", "removed"]


def test_a_peer_whose_lease_has_ended_registers_again(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="sleeper") as rt:
        presence: Any = rt._presence
        first = rt.peer("sleeper")
        leave(rt)
        assert names(rt, "sleeper") == []
        presence._wake.set()  # the peer renews its lease now
        with rt.watch_peers("sleeper") as changes:
            while "sleeper" not in names(rt):
                assert next(changes).kind in ("added", "updated")
        reconnected = rt.peer("sleeper")
        assert (reconnected.peer_id, reconnected.boot_incarnation) == (first.peer_id, first.boot_incarnation)
        rt.send("sleeper", b"good morning")
        message = rt.mailbox.get(timeout=10)
        assert message is not None
        assert message.payload == b"good morning"


def test_a_peer_that_lost_its_name_to_another_gets_an_error(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    with st.connect(cluster.address, name="torn") as rt:
        leave(rt)
        with st.connect(cluster.address, name="torn") as other:
            with pytest.raises(st.PeerExists, match="another live peer has the name 'torn'"):
                rt.mailbox.get(timeout=10)
            rt.send("torn", b"x")
            message = other.mailbox.get(timeout=10)
            assert message is not None
            assert message.payload == b"x"
            rt.close()
            assert names(other, "torn") == ["torn"]
    assert any("is no longer registered" in record.getMessage() for record in caplog.records)


def leave(rt: st.Connection) -> None:
    """Remove the peer and its mailbox, as the directory does when a lease has ended."""
    peer = rt.peer(rt.name)
    request = peer_service_pb2.DeregisterPeerRequest(
        request_id=os.urandom(16), peer_id=peer.peer_id, boot_incarnation=peer.boot_incarnation
    )
    rt._session.supernodes.call("DeregisterPeer", request, 5.0)


def test_many_named_connections_open_and_close_at_the_same_time(cluster: LocalCluster) -> None:
    async def all_of_them() -> set[str]:
        made = await asyncio.gather(*(aio.connect(cluster.address, name=f"many/{number}") for number in range(20)))
        found = {peer.name for peer in await made[0].peers("many/*")}
        await asyncio.gather(*(one.aclose() for one in made))
        return found

    assert len(asyncio.run(all_of_them())) == 20
    with st.connect(cluster.address) as rt:
        assert names(rt, "many/*") == []
