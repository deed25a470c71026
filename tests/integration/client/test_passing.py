"""Connections and handles that are copied, pickled and passed to other processes, and the texts of their `repr`."""

from __future__ import annotations

import copy
import multiprocessing
import pickle
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection as Pipe
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 40


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as rt:
        yield rt


def pickled_copy(handle: Any) -> Any:
    return pickle.loads(pickle.dumps(handle))


def test_a_pickled_channel_is_the_channel_of_that_name_with_its_codec(rt: st.Connection) -> None:
    channel = rt.channel("passing/numbers", codec="json", max_items=10)
    item = channel.put({"n": 1})
    passed = pickled_copy(channel)
    assert passed == channel
    assert passed.newest().value == {"n": 1}
    assert passed.put({"n": 2}).seq == item.seq + 1
    assert passed._session is not channel._session
    assert pickled_copy(channel)._session is passed._session, "handles from elsewhere share one connection"


def test_a_pickled_queue_group_and_descriptor_work_where_they_are_unpickled(rt: st.Connection) -> None:
    channel, queue = rt.channel("passing/camera", codec="json"), rt.queue("passing/work", codec="json", prefetch=3)
    group = rt.group("passing/group", [channel])
    queue.put([1])
    with pickled_copy(queue) as passed:
        message = passed.get(timeout=5)
        assert message is not None
        assert message.value == [1]
    assert pickled_copy(group) == group
    assert pickled_copy(group).channels[0].put({"x": 1}).value == {"x": 1}
    assert pickled_copy(group[channel]) == group[channel]


def test_a_pickled_connection_is_another_connection_to_the_same_cluster(rt: st.Connection) -> None:
    with pickled_copy(rt) as passed:
        assert passed.cluster_id == rt.cluster_id
        assert passed._session is not rt._session


def put_one(channel: st.Channel, pipe: Pipe) -> None:
    pipe.send(channel.put(b"from a spawned process"))


def test_a_handle_is_passed_to_a_spawned_process_as_it_is(rt: st.Connection) -> None:
    channel = rt.channel("passing/spawned")
    mine, theirs = multiprocessing.Pipe()
    process = multiprocessing.get_context("spawn").Process(target=put_one, args=(channel, theirs))
    process.start()
    try:
        assert mine.poll(LIMIT_S)
        put = mine.recv()
    finally:
        process.join(LIMIT_S)
        process.kill()
    assert put == channel.newest()
    assert process.exitcode == 0


def test_a_copy_of_a_handle_is_the_handle(rt: st.Connection) -> None:
    channel = rt.channel("passing/copied")
    group = rt.group("passing/copied-group", [channel])
    for handle in (rt, channel, group, group[channel], rt.queue("passing/copied-queue")):
        assert copy.deepcopy(handle) is handle
        assert copy.copy(handle) is handle


def test_an_object_with_an_open_stream_cannot_be_pickled_or_copied(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="passing-peer") as rt:
        channel, queue = rt.channel("passing/busy"), rt.queue("passing/busy-queue")
        group = rt.group("passing/busy-group", [channel])
        queue.put(b"x")
        busy = [
            channel.producer(), channel.subscribe(), channel.on_item(print), channel.sample(lambda: None),
            group.subscribe(), group.match(channel, "1ms"), rt.watch(), rt.watch_peers(), rt.mailbox, queue.get(),
        ]  # fmt: skip
        for one in busy:
            for copied in (pickle.dumps, copy.copy, copy.deepcopy):
                with pytest.raises(TypeError, match="works only in this process"):
                    copied(one)
        with pytest.raises(TypeError, match="passing-peer"):
            pickle.dumps(rt)
        assert pickled_copy(channel) == channel


def test_a_secret_that_was_an_argument_is_never_pickled(cluster: LocalCluster) -> None:
    secret = cluster.secret_file.read_text().strip()
    with st.connect(cluster.address, secret=secret) as rt:
        channel = rt.channel("passing/secret")
        for handle in (rt, channel):
            with pytest.raises(TypeError, match=r"give connect\(\) the path of the secret's file"):
                pickle.dumps(handle)
        assert secret not in repr(rt) + repr(channel) + repr(vars(rt._session))
    with st.connect(cluster.address) as rt:
        assert secret.encode() not in pickle.dumps(rt.channel("passing/secret"))


async def test_asyncio_handles_cannot_be_pickled(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address) as rt:
        channel = await rt.channel("passing/aio")
        assert copy.deepcopy(channel) is channel
        for handle in (rt, channel, await rt.queue("passing/aio"), await rt.group("passing/aio", [channel])):
            with pytest.raises(TypeError, match="event loop"):
                pickle.dumps(handle)


def test_items_answers_and_errors_are_values_that_can_be_pickled(rt: st.Connection) -> None:
    channel = rt.channel("passing/values", codec="json")
    channel.put({"n": 1}, attributes={"a": "b"})
    items = channel.get(st.OLDEST, st.NOW)
    passed = pickled_copy(items)
    assert (list(passed), passed.complete, passed.interval) == (list(items), items.complete, items.interval)
    assert passed[0].value == {"n": 1}
    nothing = pickled_copy(channel.get(items[0].time + 1, st.NOW, match="start"))
    assert (nothing.reason, bool(nothing.reason.detail)) == ("NOT_YET", True)
    error = pickled_copy(st.ChannelNotFound("no channel", metadata={"channel": "x"}))
    assert (type(error), str(error), error.metadata) == (st.ChannelNotFound, "no channel", {"channel": "x"})
    assert pickled_copy(channel.info) == channel.info


def test_every_handle_shows_its_kind_and_whether_it_is_closed(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, name="shown") as rt:
        channel, queue = rt.channel("passing/shown"), rt.queue("passing/shown-queue")
        group = rt.group("passing/shown-group", [channel])
        queue.put(b"x")
        shown: list[tuple[Any, str]] = [
            (rt, f"Connection to {cluster.address}, peer 'shown', open"),
            (channel, f"Channel 'passing/shown' {channel.info.channel_id.hex()[:8]} at host 'h1'"),
            (group, f"Group 'passing/shown-group' {group.info.group_id.hex()[:8]} of passing/shown"),
            (queue, f"Queue 'passing/shown-queue' {queue.info.queue_id.hex()[:8]} at host 'h1'"),
            (rt.mailbox, f"Mailbox 'shown' {rt.mailbox.info.queue_id.hex()[:8]} at host 'h1'"),
            (channel.producer(), "Producer of channel 'passing/shown', 0 accepted"),
            (channel.subscribe(), "Subscription to channel 'passing/shown'"),
            (group.subscribe(), "CutSubscription of group 'passing/shown-group'"),
            (group.match(channel, "1ms"), "MatchSubscription of group 'passing/shown-group'"),
            (rt.watch("a*"), "Watch of 'a*'"),
            (rt.watch_peers(), "PeerWatch of '*'"),
        ]
        for handle, text in shown:
            assert repr(handle) == f"<{text}>"
        assert "through group 'passing/shown-group'" in repr(group[channel])
        listener, sampler = channel.on_item(print), channel.sample(lambda: None)
        assert repr(listener) == "<Listener of channel 'passing/shown'>"
        closing: list[tuple[Any, Callable[[], object]]] = [
            (handle, handle.close) for handle, _ in shown if isinstance(handle, st.Subscription | st.Watch | st.Queue)
        ]
        for handle, close in closing:
            close()
            assert repr(handle).endswith(", closed>")
        for one in (listener, sampler):
            one.cancel()
            assert one.join(LIMIT_S)
            assert repr(one).endswith(", ended>")
    assert repr(rt).endswith(", connection closed>")
    assert repr(channel).endswith(", connection closed>")
