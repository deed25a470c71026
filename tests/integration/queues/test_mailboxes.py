"""Mailboxes: a peer gets the messages that others send to its name."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import wait_until

cluster = shared_cluster_fixture(hosts=1)
pair = cluster_fixture(hosts=2, supernodes=1, scope="function")


def payload_of(message: st.Message | None) -> bytes:
    assert message is not None
    message.ack()
    return message.payload


def test_a_message_reaches_a_peer_that_its_sender_found_by_name(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="planner") as planner, st.connect(cluster.address) as sender:
        (receiver,) = sender.peers("planner")
        sender.send(receiver, b"hello", attributes={"kind": "greeting"}, content_type="text/plain")
        message = planner.mailbox.get(timeout=10)
        assert message is not None
        assert (message.payload, message.attributes, message.content_type) == (
            b"hello", {"kind": "greeting"}, "text/plain",
        )  # fmt: skip
        message.ack()
        assert planner.mailbox.get(timeout=0) is None
        assert planner.mailbox.name == "planner"


def test_a_value_is_sent_and_read_with_the_same_codec(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="valued") as rt:
        rt.send("valued", {"x": [1, 2]}, codec="json")
        message = rt.mailbox.get(timeout=10)
        assert message is not None
        assert (message.content_type, message.decode("json")) == ("application/json", {"x": [1, 2]})
        assert message.value == message.decode("bytes") == message.payload
        message.ack()
        with pytest.raises(st.CodecError, match="message to 'valued'"):
            rt.send("valued", {1, 2}, codec="json")
        rt.send("valued", b"hello", content_type="text/plain")
        plain = rt.mailbox.get(timeout=10)
        assert plain is not None
        with pytest.raises(st.CodecError, match=r"^decode: message #\d+ is text/plain, not application/json; name"):
            plain.decode("json")
        plain.ack()


def test_messages_come_in_order_to_an_iterating_caller(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="reader") as reader, st.connect(cluster.address, name="writer") as writer:
        seqs = [writer.send("reader", str(number).encode()) for number in range(5)]
        assert seqs == sorted(seqs)
        found = []
        for message in reader.mailbox:
            found.append(payload_of(message))
            if len(found) == 5:
                break
        assert found == [b"0", b"1", b"2", b"3", b"4"]
        stats = reader.mailbox.stats()
        assert (stats.consumed, stats.held) == (5, 0)


def test_a_message_without_an_acknowledgement_is_delivered_again(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="forgetful") as rt:
        rt.send("forgetful", b"to myself")
        with pytest.raises(ZeroDivisionError), rt.mailbox.get(timeout=10):  # type: ignore[union-attr]
            raise ZeroDivisionError
        message = rt.mailbox.get(timeout=10)
        assert message is not None
        assert message.deliveries == 2


def test_a_message_to_a_peer_that_does_not_exist_is_refused(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        with pytest.raises(st.PeerNotFound, match="no live peer is named 'nobody'"):
            rt.send("nobody", b"x")
        with pytest.raises(st.InvalidName, match="peer name"):
            rt.send("Not a name", b"x")
        with pytest.raises(st.InvalidArgument, match="encode"):
            rt.send("nobody", "text")


def is_gone(sender: st.Connection, peer: str) -> bool:
    """Whether a message to that peer is refused, because the directory has no such peer."""
    try:
        sender.send(peer, b"lost")
    except st.PeerNotFound:
        return True
    return False


def test_a_peer_that_left_and_registered_again_is_found(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as sender:
        with st.connect(cluster.address, name="guest") as first:
            sender.send("guest", b"1")
            assert payload_of(first.mailbox.get(timeout=10)) == b"1"
        wait_until(lambda: is_gone(sender, "guest"), "the mailbox's host learns that its peer left")
        with st.connect(cluster.address, name="guest") as second:
            sender.send("guest", b"2")
            assert payload_of(second.mailbox.get(timeout=10)) == b"2"


def test_closing_the_connection_wakes_the_caller_that_waits_at_its_mailbox(cluster: LocalCluster) -> None:
    rt = st.connect(cluster.address, name="waiter")
    errors: list[st.Unavailable] = []

    def wait() -> None:
        with pytest.raises(st.Unavailable) as caught:
            rt.mailbox.get()
        errors.append(caught.value)

    waiting = threading.Thread(target=wait)
    waiting.start()
    with st.connect(cluster.address) as other:
        while rt.mailbox.stats().waiting_gets != 1:
            assert other.peer("waiter").alive
    rt.close()
    waiting.join(10)
    assert [error.message for error in errors] == ["this connection is closed; call connect() again"]


async def test_a_mailbox_of_the_asyncio_client_gets_and_acknowledges_a_message(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address, name="aio") as rt:
        get = asyncio.ensure_future(rt.mailbox.get())
        await rt.send("aio", b"x")
        message = await asyncio.wait_for(get, 45)
        assert message is not None
        async with message:
            assert message.payload == b"x"
        assert (await rt.mailbox.stats()).consumed == 1


def test_a_mailbox_whose_host_is_lost_is_replaced(pair: LocalCluster) -> None:
    with st.connect(pair.address, name="survivor") as rt, st.connect(pair.address) as sender:
        sender.send("survivor", b"before")
        assert payload_of(rt.mailbox.get(timeout=10)) == b"before"
        found: list[Any] = []
        waiting = threading.Thread(target=lambda: found.append(_patient_get(rt)))
        waiting.start()
        lost = rt.mailbox.host
        next(host for host in pair.hosts if lost in host.name or host.name in lost).kill()
        _patient_send(sender, "survivor", b"after")
        waiting.join(40)
        assert [payload_of(one) for one in found] == [b"after"]
        assert rt.mailbox.host != lost


def _patient_get(rt: st.Connection) -> st.Message | None:
    """Get again after each Unavailable, until the mailbox has a new host."""
    for _ in range(4):
        try:
            return rt.mailbox.get()
        except st.Unavailable:
            continue
    return None


def _patient_send(rt: st.Connection, peer: str, payload: bytes) -> None:
    for _ in range(4):
        try:
            rt.send(peer, payload)
            return
        except (st.Unavailable, st.QueueNotFound, st.DeadlineExceeded):
            continue
    raise AssertionError("the mailbox did not come back")
