"""A cluster in memory has no data after a restart. Handles then open, by name, what they had opened before."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

pytestmark = pytest.mark.without_rules("a restarted cluster in memory forgets its rules and the keys of tokens")
cluster = cluster_fixture(hosts=1, supernodes=1, durable=False)
LIMIT_S = 40


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as rt:
        yield rt


def restart(cluster: LocalCluster) -> None:
    """Restart all parts at the same addresses, without their data."""
    for process in cluster.processes():
        process.kill()
    for process in reversed(list(cluster.processes())):
        process.restart()


def test_puts_and_gets_open_a_lost_channel_again_and_continue(cluster: LocalCluster, rt: st.Connection) -> None:
    channel = rt.channel("anew/camera", max_items=7)
    before = channel.put(b"gone")
    restart(cluster)
    item = channel.put(b"anew")
    assert item.incarnation != before.incarnation
    assert [one.payload for one in channel.get(st.OLDEST, st.NEWEST)] == [b"anew"]
    assert rt.channel("anew/camera", create=False).info.policy.max_items == 7, "the channel is set up as it was"
    with pytest.raises(st.IncarnationLost):
        channel.newest(after=before)


def test_a_handle_with_create_false_fails_until_another_caller_creates_the_channel(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    rt.channel("anew/others").put(b"gone")
    reader = rt.channel("anew/others", create=False)
    restart(cluster)
    with pytest.raises(st.ChannelNotFound, match="anew/others"):
        reader.newest()
    with st.connect(cluster.address) as other:
        other.channel("anew/others").put(b"by another")
    newest = reader.newest()
    assert newest is not None
    assert newest.payload == b"by another"


def test_a_handle_opens_a_lost_queue_again_and_continues(cluster: LocalCluster, rt: st.Connection) -> None:
    queue = rt.queue("anew/work", max_items=5)
    queue.put(b"gone")
    restart(cluster)
    queue.put(b"anew", timeout=5)
    message = queue.get(timeout=LIMIT_S)
    assert message is not None
    assert message.payload == b"anew"
    message.ack()
    assert queue.stats().policy.max_items == 5


def test_a_named_connection_registers_again_and_gets_another_mailbox(cluster: LocalCluster) -> None:
    got: list[st.Message | None] = []
    with st.connect(cluster.address, name="anew-peer") as rt, st.connect(cluster.address) as other:
        other.send("anew-peer", b"gone")
        restart(cluster)
        taker = threading.Thread(target=lambda: got.append(rt.mailbox.get(timeout=LIMIT_S)), daemon=True)
        taker.start()
        wait = threading.Event()
        for _ in range(LIMIT_S * 10):
            try:
                other.send("anew-peer", b"anew")
                break
            except (st.PeerNotFound, st.Unavailable):
                wait.wait(0.1)
        taker.join(LIMIT_S)
        assert [message.payload for message in got if message] == [b"anew"]


def test_a_deleted_channel_stays_deleted_until_its_name_is_used_again(cluster: LocalCluster, rt: st.Connection) -> None:
    channel, queue = rt.channel("anew/deleted"), rt.queue("anew/deleted")
    channel.put(b"gone")
    queue.put(b"gone")
    with st.connect(cluster.address) as other:
        other.channel("anew/deleted").delete()
        other.queue("anew/deleted").delete()
        with pytest.raises(st.ChannelNotFound):
            channel.put(b"x")
        with pytest.raises(st.QueueNotFound):
            queue.put(b"x")
        assert not rt.channels("anew/deleted")
        other.channel("anew/deleted", max_items=3).put(b"another")
        other.queue("anew/deleted").put(b"another")
        newest = channel.newest()
        assert newest is not None
        assert newest.payload == b"another"
        message = queue.get(timeout=5)
        assert message is not None
        assert message.payload == b"another"


def test_a_lost_group_is_opened_again_with_its_members_and_its_events_report_the_loss(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    left, right = rt.channel("anew/left"), rt.channel("anew/right")
    group = rt.group("anew/pair", [left, right], reference=right, bound="end", max_lead="2s")
    for channel in (left, right):
        channel.put(b"gone")
    cuts = group.subscribe()
    restart(cluster)
    assert [one.payload if one else None for one in group.newest().values()] == [None, None]
    with pytest.raises(st.IncarnationLost):
        next(cuts)
    found = rt.group("anew/pair")
    assert found == group
    assert [one.name for one in found] == ["anew/left", "anew/right"]
    assert found.info.reference_id == right.info.channel_id
    assert (found.info.bound, found.info.max_lead_nanos) == ("end", 2_000_000_000)
    group.delete()
    for gone in (group.refresh, group.newest, group[left].newest):
        with pytest.raises(st.GroupNotFound, match="anew/pair"):
            for_ever(gone)  # the directory knows of the deletion immediately, and hosts a moment later


def test_matches_report_the_loss_immediately_and_continue_with_new_items(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    left, right = rt.channel("anew/one", max_age="1h"), rt.channel("anew/two", max_age="1h")
    group = rt.group("anew/matched", [left, right])
    matches = group.match(per=left, tolerance="10ms")
    base = st.now()
    assert put_pairs(base, left, right) == next(matches).time
    restart(cluster)
    with pytest.raises(st.IncarnationLost, match="anew/matched"):
        next(matches)
    with group.match(per=left, tolerance="10ms") as anew:
        earlier = base - 10**9  # the times of the items may begin anew, too, as in a replay
        assert put_pairs(earlier, left, right) == next(anew).time


def for_ever(call: Callable[[], object]) -> None:
    """Call until it raises, or the test's time is over."""
    while True:
        call()


def put_pairs(time: int, *channels: st.Channel) -> int:
    """Put a pair, and later items that show that no nearer partner comes. Returns the time of the pair."""
    for channel in channels:
        channel.put(b"pair", time=time)
    for channel in channels:
        channel.put(b"later", time=time + 10**8)
    return time
