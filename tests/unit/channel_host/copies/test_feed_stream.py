"""The owner of a channel sends a put to a replica, and the replica answers, in the turn in which the bytes come."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError
from stampede_rt.v1 import channel_service_pb2
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt.values.policy import parse_policy
from stampede_rt.wire.put_frames import put_head, put_request
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import run_parts
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.copies import feed_opening
from stampede_rt_channel_host.copies.copy_feed import GRANTS, RUNS_PER_TURN, CopyFeed
from stampede_rt_channel_host.copies.fed_items import encode_answer
from stampede_rt_channel_host.copies.fed_responses import FedResponse, read_response
from stampede_rt_channel_host.copies.feed_stream import FeedStream
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES, ChannelFeed, FedItem
from stampede_rt_channel_host.core.replication import KnownReplica
from stampede_rt_runtime import pacing
from tests.support.channel_host.held_transport import HeldStream, HeldTransport, held_stream
from tests.support.channel_host.rig import OpenedChannel, running_host

REPLICA = b"r" * 16
WINDOW_BYTES = 2**20


@pytest.fixture(autouse=True)
def unlimited_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine one answer may take longer than the budget."""
    monkeypatch.setattr(pacing, "SAME_TURN_NANOS", 2**62)


class Fed:
    """A channel with one replica in sync, the stream of a producer, and the stream that feeds the replica."""

    def __init__(self, channel: OpenedChannel, hosted: HostedChannel, producer: HeldStream, feed: HeldStream) -> None:
        self.channel, self.hosted, self.producer, self.feed = channel, hosted, producer, feed
        self._number = 0

    def put(self, *payloads: bytes, times: Sequence[int] | None = None) -> list[bytes]:
        """Put a run, or an item. Returns the bytes that the host wrote to the replica before the put returned."""
        payloads = payloads or (b"x",)
        head, before = put_head(self.channel.channel_id, self.channel.epoch, 7), len(self.feed.written())
        self.producer.send(put_request(head, self._number + 1, run_parts(payloads, times=times), 10**9))
        self._number += len(payloads)
        return self.feed.written()[before:]

    def answer(self) -> None:
        """Report it in answer to an item."""
        assert self.feed.send(encode_answer(self.hosted.core.next_seq)) == []

    def report(self, **fields: Any) -> None:
        """Report that the replica has all items so far."""
        request = pb.FeedRequest(held_next_seq=self.hosted.core.next_seq, sent_nanos=1, **fields)
        assert self.feed.send(request.SerializeToString()) == []

    def acks(self) -> list[channel_service_pb2.PutAck]:
        return [one for raw in self.producer.written() for one in channel_service_pb2.PutResponse.FromString(raw).acks]


@asynccontextmanager
async def fed(
    *, takes_puts: bool = True, takes_items: bool = False, takes_runs: bool = False, **policy: Any
) -> AsyncIterator[Fed]:
    async with running_host() as rig:
        spec = policy_to_spec(parse_policy(replicas=1, ack="replica", **policy))
        record = rig.directory.add_channel("a", rig.host.identity.host_id, spec)
        channel = OpenedChannel(rig, record)
        feed = await held_stream(rig.sockets, "/stampede_rt.v1.ReplicaService/Feed")
        opening = pb.FeedOpen(
            channel_id=record.channel_id, epoch=record.epoch, host_id=REPLICA, target="replica:1", owner_facts=True,
            takes_puts=takes_puts, takes_items=takes_items, takes_runs=takes_runs,
        )  # fmt: skip
        hosted = await rig.host.store.bind_for_feed(record.channel_id, record.epoch)
        assert hosted.replication is not None
        hosted.replication.know([KnownReplica(REPLICA, 1, False)])
        feed.send(pb.FeedRequest(open=opening, credit_bytes=WINDOW_BYTES, sent_nanos=1).SerializeToString())
        await feed.until_written(1)
        made = Fed(channel, hosted, await held_stream(rig.sockets, "/stampede_rt.v1.ChannelService/Put"), feed)
        made.report()
        for change in hosted.replication.changes():
            hosted.replication.confirm(change)
        await pauses()
        yield made
        made.producer.close()
        feed.close()


async def test_feeds_that_wait_for_the_directory_do_not_exceed_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed_opening, "FEEDS_MAX", 1)
    async with running_host() as rig:
        record = rig.directory.add_channel("a", rig.host.identity.host_id, policy_to_spec(parse_policy(replicas=1)))
        feeds = [await held_stream(rig.sockets, "/stampede_rt.v1.ReplicaService/Feed") for _ in range(2)]
        hosted = await rig.host.store.bind_for_feed(record.channel_id, record.epoch)
        hosts = [bytes([number]) * 16 for number in range(2)]
        for feed, host_id in zip(feeds, hosts, strict=True):
            opening = pb.FeedOpen(
                channel_id=record.channel_id, epoch=1, host_id=host_id, target="replica:1", owner_facts=True
            )
            feed.send(pb.FeedRequest(open=opening, credit_bytes=WINDOW_BYTES, sent_nanos=1).SerializeToString())
        await pauses()
        assert hosted.replication is not None
        hosted.replication.know([KnownReplica(one, 1, False) for one in hosts])
        await pauses()
        assert len([*(hosted.fed or ())]) == 1
        for feed in feeds:
            feed.close()


async def pauses() -> None:
    """Let the tasks of both streams run until they wait."""
    for _ in range(20):
        await asyncio.sleep(0)


def parts_in(messages: list[bytes]) -> list[FedResponse]:
    return [one for one in map(read_response, messages) if isinstance(one, FedResponse)]


def items_in(messages: list[bytes]) -> list[FedItem]:
    return [one for one in map(read_response, messages) if isinstance(one, FedItem)]


async def test_a_put_goes_to_the_replica_in_the_turn_in_which_it_comes() -> None:
    async with fed() as one:
        for seq in (1, 2, 3):
            [part] = parts_in(one.put())
            assert (part.fields.state.first_seq, part.fields.state.next_seq, len(part.runs)) == (seq, seq + 1, 1)
            assert len(one.acks()) == seq - 1, "the replica has not answered yet"
            one.report()
            assert len(one.acks()) == seq, "the ack is written in the turn in which the replica answers"
            assert one.acks()[-1].copies == 2
        await pauses()
        assert one.put(), "the task of the feed has nothing to send, and waits"


@pytest.mark.parametrize("takes_puts", [False, True])
async def test_a_replica_that_knows_the_producer_gets_the_short_form_of_a_put_if_it_understands_it(
    takes_puts: bool,
) -> None:
    async with fed(takes_puts=takes_puts) as one:
        forms = []
        for _ in range(3):
            [part] = parts_in(one.put())
            forms.append((part.fields.state.HasField("owner"), part.fields.state.HasField("put")))
            one.report()
        full, short = (True, False), (False, True)
        assert forms == ([full, short, short] if takes_puts else [full] * 3)


async def test_a_producer_has_its_ack_when_the_host_wakes_the_readers() -> None:
    async with fed() as one:
        acks_at_wakes: list[int] = []
        one.hosted.group_observers[WakingObserver(lambda: acks_at_wakes.append(len(one.acks())))] = None
        for _ in range(2):
            one.put()
            one.report()
        assert acks_at_wakes == [1, 2]


class WakingObserver:
    """An observer of a channel that calls `wake`."""

    def __init__(self, wake: Callable[[], object]) -> None:
        self.wake = wake

    def end(self, error: StampedeError) -> None:
        """The channel goes on until the host stops."""


async def test_the_items_that_come_while_the_replica_lacks_one_go_out_together() -> None:
    async with fed() as one:
        assert one.put()
        assert one.put() == one.put() == []
        count = len(one.feed.written())
        [part] = parts_in((await one.feed.until_written(count + 1))[count:])
        assert (part.fields.state.first_seq, part.fields.state.next_seq) == (2, 4)


async def test_a_feed_writes_the_stored_bytes_of_a_long_item_without_a_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[bytes] = []
    async with fed() as one:
        monkeypatch.setattr(HeldTransport, "writelines", lambda _, parts: written.extend(parts))
        one.put(bytes(100_000))
        [stored] = one.hosted.core.accepted_from(0)
        assert any(part is stored.run.body for part in written)


async def test_the_feed_of_a_proxy_looks_once_for_each_item(monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[int] = []
    take = ChannelFeed.take

    def noted(feed: ChannelFeed, now: int, limit_bytes: int) -> Any:
        looks.append(limit_bytes)
        return take(feed, now, limit_bytes)

    async with running_host() as rig:
        record = rig.directory.add_channel("a", rig.host.identity.host_id, policy_to_spec(parse_policy()))
        feed = await held_stream(rig.sockets, "/stampede_rt.v1.ReplicaService/Feed")
        opening = pb.FeedOpen(channel_id=record.channel_id, epoch=record.epoch, host_id=REPLICA, target="proxy:1")
        feed.send(pb.FeedRequest(open=opening, credit_bytes=WINDOW_BYTES, sent_nanos=1).SerializeToString())
        await feed.until_written(1)
        producer = await held_stream(rig.sockets, "/stampede_rt.v1.ChannelService/Put")
        await pauses()
        monkeypatch.setattr(ChannelFeed, "take", noted)
        for number in (1, 2, 3):
            head = put_head(record.channel_id, record.epoch, 7)
            producer.send(put_request(head, number, run_parts((b"x",), times=None), 10**9))
            await feed.until_written(1 + number)
            await pauses()
        assert len(looks) == 3
        producer.close()
        feed.close()


async def test_an_error_while_a_part_is_sent_ends_the_feed_and_not_the_put(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fed() as one:
        replication = one.hosted.replication
        assert replication is not None

        def fail(*_: object) -> bytes:
            raise RuntimeError("no message")

        monkeypatch.setattr(FeedStream, "_encoded", fail)
        assert one.put() == []
        assert one.hosted.core.next_seq == 2, "the host has accepted the item"
        await pauses()
        assert replication._feeds == {}, "the feed is over"


async def test_a_replica_without_credit_gets_nothing_in_the_turn_of_the_put() -> None:
    async with fed() as one:
        one.feed.connection.take_in_same_turn = None  # so that the stream takes no request meanwhile
        stream = one.hosted.replication
        assert stream is not None
        [feed] = stream._feeds.values()
        feed._credit.amount_left = 0  # type: ignore[attr-defined]
        assert one.put() == []


async def test_a_replica_answers_a_part_in_the_turn_in_which_it_comes() -> None:
    async with fed() as one, running_host() as other:
        copied = CopyFeed(
            other.host.store, one.hosted.record, CopyState(lambda: 0), REPLICA, "replica:1", owner_facts=True
        )
        sent: list[pb.FeedRequest] = []
        call: Any = SimpleNamespace(write_now=sent.append)
        [opened] = parts_in(one.feed.written()[:1])
        assert not copied._take_in_same_turn(call, opened), "the task begins the copy"
        await copied._take(opened)
        [part] = parts_in(one.put())
        assert copied._take_in_same_turn(call, part)
        assert [one.held_next_seq for one in sent] == [2]
        held = copied._held()
        assert held is not None
        assert held.channel.next_seq == 2


async def test_a_replica_grants_credit_in_large_steps_with_its_answers_to_puts() -> None:
    charge_bytes = 1 + ITEM_OVERHEAD_BYTES  # the charge of one put
    async with fed() as one, running_host() as other:
        copied = CopyFeed(
            other.host.store, one.hosted.record, CopyState(lambda: 0), REPLICA, "replica:1", owner_facts=True,
            window_bytes=GRANTS * 3 * charge_bytes,
        )  # fmt: skip
        sent: list[pb.FeedRequest] = []
        call: Any = SimpleNamespace(write_now=sent.append)
        await copied._take(parts_in(one.feed.written()[:1])[0])
        for _ in range(7):
            [part] = parts_in(one.put())
            assert copied._take_in_same_turn(call, part)
            one.report()
            await pauses()
        assert [request.credit_bytes for request in sent if request.credit_bytes] == [3 * charge_bytes] * 2


async def test_a_replica_reports_no_part_that_it_cannot_store() -> None:
    async with fed() as one, running_host() as other:
        copied = CopyFeed(
            other.host.store, one.hosted.record, CopyState(lambda: 0), REPLICA, "replica:1", owner_facts=True
        )
        sent: list[pb.FeedRequest] = []
        call: Any = SimpleNamespace(write_now=sent.append)
        await copied._take(parts_in(one.feed.written()[:1])[0])
        [part] = parts_in(one.put())
        held = copied._held()
        assert held is not None
        part.fields.state.first_seq += 1
        part.fields.state.next_seq += 1
        with pytest.raises(InvalidArgument, match="the feed continues at seq 2"):
            copied._take_in_same_turn(call, part)
        part.fields.state.first_seq -= 1
        part.fields.state.next_seq -= 1
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(held, "make_room", _refuse)
            with pytest.raises(Overloaded):
                copied._take_in_same_turn(call, part)
        assert sent == []


def _refuse(_: int) -> None:
    raise Overloaded("the host has no room")


@pytest.mark.parametrize("state", ["a long part", "a request under way", "a full socket"])
async def test_a_replica_leaves_other_parts_to_its_tasks(state: str) -> None:
    async with fed() as one, running_host() as other:
        copied = CopyFeed(
            other.host.store, one.hosted.record, CopyState(lambda: 0), REPLICA, "replica:1", owner_facts=True
        )
        await copied._take(parts_in(one.feed.written()[:1])[0])
        [part] = parts_in(one.put())
        call: Any = SimpleNamespace(write_now=None)
        if state == "a long part":
            part = part._replace(runs=[part.runs[0]] * (RUNS_PER_TURN + 1))
        elif state == "a request under way":
            await copied._requests._turn.acquire()
        woken = copied._requests._wakeup
        woken.clear()
        assert copied._take_in_same_turn(call, part) == (state == "a full socket")
        assert woken.is_set() == (state == "a full socket"), "the task that writes sends the answer later"
