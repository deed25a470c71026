"""Readers in other network namespaces, and a network that loses and reorders datagrams."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.namespaces import NamespaceNetwork, NetworkNamespace, unavailable_because
from tests.integration.multicast.lossy_multicast import LossyMulticast
from tests.support.cluster import running_cluster
from tests.support.waiting import wait_until

WHY_NOT = unavailable_because()
pytestmark = pytest.mark.skipif(WHY_NOT is not None, reason=WHY_NOT or "")
GROUP = "239.255.7.6:7586"
ITEMS = 400
SIZES = (60, 700, 9000, 200)
READERS = 3


def read(namespace: NetworkNamespace, address: str, name: str, sender: Any) -> None:
    """Read a channel to its end in this process. Sends each seq to `sender`, and the checks and counts at the end."""
    namespace.enter()
    with st.connect(address, transport="grpc") as rt:
        subscription = rt.channel(name, create=False).subscribe(st.OLDEST, via="multicast")
        damaged = 0
        for item in subscription:
            damaged += item.payload != payload_of(item.seq)
            sender.send((item.seq, subscription.multicast.following))
            if item.attributes.get("last"):
                break
        sender.send((subscription.multicast, subscription.dropped, damaged))


def payload_of(seq: int) -> bytes:
    return b"%d" % seq * (SIZES[seq % len(SIZES)] // len(b"%d" % seq))


@dataclass
class Reader:
    process: Any
    receiver: Any

    def __post_init__(self) -> None:
        self.seqs, self.follows, self.end = list[int](), False, None

    def look(self) -> None:
        while self.end is None and self.receiver.poll():
            found = self.receiver.recv()
            if len(found) == 2:
                self.seqs.append(found[0])
                self.follows = found[1]
            else:
                self.end = found


@dataclass
class Rig:
    """One host, and READERS namespaces behind a lossy network."""

    cluster: LocalCluster
    network: LossyMulticast
    namespaces: list[NetworkNamespace]
    rt: st.Connection

    def begin(self, name: str) -> list[Reader]:
        spawn, readers = multiprocessing.get_context("spawn"), []
        for namespace in self.namespaces:
            receiver, sender = spawn.Pipe(duplex=False)
            process = spawn.Process(target=read, args=(namespace, self.cluster.address, name, sender), daemon=True)
            process.start()
            readers.append(Reader(process, receiver))
        return readers


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with NamespaceNetwork(1 + READERS) as made:
        host, *readers = made.namespaces
        settings = {"listen": f"{made.address}:0", "host_namespaces": [host], "allow_insecure_anywhere": True}
        with (
            running_cluster(hosts=1, supernodes=1, durable=False, multicast=GROUP, **settings) as cluster,
            LossyMulticast(host, readers, loss=0.05, late=0.1, seed=7) as network,
            st.connect(cluster.address, transport="grpc") as rt,
        ):
            yield Rig(cluster, network, readers, rt)


def follow(channel: Any, readers: list[Reader]) -> None:
    """Put items until all readers take them from datagrams."""

    def all_follow() -> bool:
        channel.put(payload_of(channel.stats().accepted + 1))
        for reader in readers:
            reader.look()
        return all(reader.follows for reader in readers)

    wait_until(all_follow, "all readers hear the datagrams")


def ended(readers: list[Reader]) -> bool:
    for reader in readers:
        reader.look()
    return all(reader.end is not None for reader in readers)


def test_readers_get_each_item_once_in_order_despite_lost_and_reordered_datagrams(rig: Rig) -> None:
    channel = rig.rt.channel("lossy/one", max_items=10**5)
    readers = rig.begin(channel.name)
    follow(channel, readers)
    for seq in range(channel.stats().accepted + 1, ITEMS):
        channel.put(payload_of(seq))
    channel.put(payload_of(ITEMS), attributes={"last": "yes"})
    wait_until(lambda: ended(readers), "all readers are at the end")
    for reader in readers:
        stats, dropped, damaged = reader.end
        assert reader.seqs == [*range(1, ITEMS + 1)]
        assert (dropped, damaged, stats.forged, stats.following) == (0, 0, 0, True)
        assert stats.repairs > 1
        assert stats.items > 0
        reader.process.join(20)
    assert rig.network.lost > 0


def test_a_frozen_and_a_killed_reader_harm_no_other_reader_and_the_frozen_reader_catches_up(rig: Rig) -> None:
    channel = rig.rt.channel("lossy/two", max_items=10**5)
    frozen, killed, other = readers = rig.begin(channel.name)
    follow(channel, readers)
    first = channel.stats().accepted + 1
    _signal(frozen, signal.SIGSTOP)
    _signal(killed, signal.SIGKILL)
    for seq in range(first, first + ITEMS - 1):
        channel.put(payload_of(seq))
    end = first + ITEMS - 1
    channel.put(payload_of(end), attributes={"last": "yes"})
    wait_until(lambda: ended([other]), "the other reader is at the end")
    assert frozen.end is None
    _signal(frozen, signal.SIGCONT)
    wait_until(lambda: ended([frozen]), "the frozen reader is at the end")
    for reader in (frozen, other):
        assert reader.seqs == [*range(1, end + 1)]
        assert reader.end[1:] == (0, 0)
        reader.process.join(20)


def test_readers_continue_over_their_stream_if_no_datagram_arrives(rig: Rig) -> None:
    channel = rig.rt.channel("lossy/three", max_items=10**5)
    readers = rig.begin(channel.name)
    follow(channel, readers)
    before, rig.network.loss = rig.network.loss, 1.0
    try:
        first = channel.stats().accepted + 1
        channel.put(payload_of(first))
        wait_until(
            lambda: not any(_looked(one).follows for one in readers) or _put(channel),
            "all readers have left the datagrams",
        )
        channel.put(payload_of(channel.stats().accepted + 1), attributes={"last": "yes"})
        wait_until(lambda: ended(readers), "all readers are at the end")
    finally:
        rig.network.loss = before
    end = channel.stats().accepted
    for reader in readers:
        assert reader.seqs == [*range(1, end + 1)]
        assert not reader.end[0].following
        reader.process.join(20)


def _put(channel: Any) -> bool:
    channel.put(payload_of(channel.stats().accepted + 1))
    return False


def _looked(reader: Reader) -> Reader:
    reader.look()
    return reader


def _signal(reader: Reader, number: signal.Signals) -> None:
    os.kill(reader.process.pid, number)
