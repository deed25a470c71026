"""The owner of a channel sends an item to its replica before it stores the item itself."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt.wire.put_frames import put_head, put_request
from stampede_rt.wire.runs import run_parts
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.copies.copy_feed import CopyFeed
from stampede_rt_channel_host.copies.fed_items import read_answer
from stampede_rt_channel_host.copies.fed_responses import read_response
from stampede_rt_channel_host.copies.feed_calls import encode_request
from stampede_rt_channel_host.copies.feed_opening import has_others_items
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES
from stampede_rt_channel_host.core.channel.holdings import Holdings
from tests.support.channel_host.held_transport import held_stream
from tests.support.channel_host.rig import run_of, running_host
from tests.unit.channel_host.copies.test_feed_stream import (
    REPLICA,
    Fed,
    fed,
    items_in,
    parts_in,
    pauses,
    unlimited_time,
)

__all__ = ["unlimited_time"]


@asynccontextmanager
async def copy_with_first_item(one: Fed) -> AsyncIterator[tuple[CopyFeed, Any, list[tuple[int, int]]]]:
    """Yield a replica that has the first item of `one`, its stream, and its answers.

    Each answer has the place that it reports, and the next seq of the replica at that moment.
    """
    async with running_host() as other:
        copied = CopyFeed(
            other.host.store, one.hosted.record, CopyState(lambda: 0), REPLICA, "replica:1", owner_facts=True
        )
        sent: list[tuple[int, int]] = []

        def write(request: pb.FeedRequest | bytes) -> None:
            held: Any = copied._held()
            sent.append((read_answer(encode_request(request)), held.channel.next_seq))

        call: Any = SimpleNamespace(write_now=write)
        await copied._take(read_response(one.feed.written()[0]))
        [first] = parts_in(one.put())
        assert copied._take_in_same_turn(call, first)
        one.report()
        yield copied, call, sent


def begin(one: Fed) -> None:
    """Put the first item, so that the replica knows the producer."""
    assert len(parts_in(one.put())) == 1
    one.report()


async def test_an_item_goes_to_the_replica_before_the_owner_stores_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fed(takes_items=True) as one:
        begin(one)
        written_before: list[int] = []
        store = Holdings.store

        def note_and_store(held: Holdings, *arguments: Any) -> None:
            written_before.append(len(items_in(one.feed.written())))
            store(held, *arguments)

        monkeypatch.setattr(Holdings, "store", note_and_store)
        for count in (1, 2):
            written_before.clear()
            [item] = items_in(one.put())
            assert (item.item.seq, one.hosted.core.next_seq) == (count + 1, count + 2)
            assert written_before[0] == count
            assert len(one.acks()) == count, "the replica has not answered yet"
            one.answer()
            assert [len(one.acks()), one.acks()[-1].copies] == [count + 1, 2]


async def test_the_replica_loses_collected_items_with_the_next_item_or_sign_of_life() -> None:
    async with fed(takes_items=True, max_items=2) as one:
        begin(one)
        floors: list[int | None] = []
        for _ in range(5):
            message = one.put()
            found = [None if item.collected is None else item.collected.floor[1] for item in items_in(message)]
            floors += found or [-part.fields.state.collection.floor.seq for part in parts_in(message)]
            one.report()
            await pauses()
        # seq 4 goes in the general form, because an item was collected for another cause than before
        assert floors == [None, None, -3, None, 4]
        count = len(one.feed.written())
        one.feed.send(pb.FeedRequest(held_next_seq=7, sent_nanos=2).SerializeToString())
        [part] = parts_in((await one.feed.until_written(count + 1))[count:])
        assert part.fields.state.collection.floor.seq == 5


async def test_a_replica_answers_an_item_before_it_stores_it() -> None:
    async with fed(takes_items=True) as one, copy_with_first_item(one) as (copied, call, sent):
        held: Any = copied._held()
        for seq in (2, 3):
            [item] = items_in(one.put())
            one.answer()
            assert copied._take_in_same_turn(call, item)
            assert sent[-1] == (seq + 1, seq), "the answer comes before the storing"
            assert held.channel.next_seq == seq + 1
        assert held.channel.counters(0).accepted == one.hosted.core.counters(0).accepted
        assert held.channel.owner_facts.window.producers[7].recorded == 3
        with pytest.raises(InvalidArgument, match="has the item with seq 3, and the copy is at 4"):
            copied._take_in_same_turn(call, item)


async def test_a_replica_refuses_an_item_without_a_producer() -> None:
    async with fed(takes_items=True) as one, copy_with_first_item(one) as (copied, call, sent):
        [fed_item] = items_in(one.put())
        count = len(sent)
        with pytest.raises(InvalidArgument, match="an item without a producer"):
            copied._take_in_same_turn(call, fed_item._replace(item=fed_item.item._replace(producer_id=0)))
        assert len(sent) == count


async def test_a_run_goes_to_the_replica_before_the_owner_stores_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async with fed(takes_items=True, takes_runs=True) as one:
        begin(one)
        written_before: list[int] = []
        store = Holdings.store

        def note_and_store(held: Holdings, *arguments: Any) -> None:
            written_before.append(len(items_in(one.feed.written())))
            store(held, *arguments)

        monkeypatch.setattr(Holdings, "store", note_and_store)
        [item] = items_in(one.put(b"a", b"bc", b""))
        assert (item.item.seq, item.item.end_seq, item.item.length) == (2, 5, 3)
        assert (one.hosted.core.next_seq, written_before[0]) == (5, 1)
        assert len(one.acks()) == 1, "the replica has not answered yet"
        one.answer()
        assert [(ack.first_seq, ack.items, ack.copies) for ack in one.acks()[1:]] == [(2, 3, 2)]


async def test_a_replica_answers_a_run_before_it_stores_it() -> None:
    async with fed(takes_items=True, takes_runs=True) as one, copy_with_first_item(one) as (copied, call, sent):
        held: Any = copied._held()
        for offsets in ((), (5, 3, 4)):  # without times, and with times after the newest item
            seq, newest, granted = one.hosted.core.next_seq, one.hosted.core.newest, copied._granted
            assert newest is not None
            times = [newest + offset for offset in offsets] or None
            [item] = items_in(one.put(b"a", b"bc", b"", times=times))
            one.answer()
            assert copied._take_in_same_turn(call, item)
            assert sent[-1] == (seq + 3, seq), "the answer comes before the storing"
            assert held.channel.next_seq == seq + 3
            assert copied._granted - granted == 3 + 3 * ITEM_OVERHEAD_BYTES
        copied_counts, owner_counts = held.channel.counters(0), one.hosted.core.counters(0)
        assert (copied_counts.accepted, copied_counts.accepted_bytes) == (
            owner_counts.accepted,
            owner_counts.accepted_bytes,
        )
        for first_number in (2, 5):
            at_copy = held.channel.owner_facts.window.find(7, first_number, 3, 0)
            at_owner = one.hosted.puts.retries.find(7, first_number, 3, 0)
            assert at_copy[:-1] == at_owner[:-1], "only the clocks differ"


@pytest.mark.parametrize("field", ["seq", "items", "length"])
async def test_a_replica_refuses_a_run_that_disagrees_with_its_items(field: str) -> None:
    async with fed(takes_items=True, takes_runs=True) as one, copy_with_first_item(one) as (copied, call, sent):
        [fed_item] = items_in(one.put(b"a", b"bc"))
        count = len(sent)
        wrong = fed_item.item._replace(**{field: getattr(fed_item.item, field) + 1})
        with pytest.raises(InvalidArgument, match="disagrees with its items"):
            copied._take_in_same_turn(call, fed_item._replace(item=wrong))
        assert len(sent) == count


async def test_while_the_replica_lacks_a_run_the_owner_collects_the_next_runs_and_sends_them_together() -> None:
    async with fed(takes_items=True, takes_runs=True) as one:
        begin(one)
        assert len(items_in(one.put(b"a", b"b"))) == 1
        assert one.put(b"c", b"d") == one.put(b"e", b"f") == []
        count = len(one.feed.written())
        [part] = parts_in((await one.feed.until_written(count + 1))[count:])
        assert (part.fields.state.first_seq, part.fields.state.next_seq, len(part.runs)) == (4, 8, 2)
        one.report()
        await pauses()
        assert len(items_in(one.put(b"g", b"h"))) == 1


@pytest.mark.parametrize("transport", ["grpc", "socket"])
async def test_the_replica_and_the_readers_learn_of_all_runs_of_a_request_together(
    monkeypatch: pytest.MonkeyPatch, transport: str
) -> None:
    async with fed(takes_items=True, takes_runs=True) as one:
        begin(one)
        replication = one.hosted.replication
        assert replication is not None
        next_seqs: list[int] = []
        accepted = replication.accepted

        def note_and_accept(now: int) -> None:
            next_seqs.append(one.hosted.core.next_seq)
            accepted(now)

        monkeypatch.setattr(replication, "accepted", note_and_accept)
        count = len(one.feed.written())
        runs = [run_of(b"a", b"b", number=2), run_of(b"c", b"d", number=4), run_of(b"e", b"f", number=6)]
        request = channel_pb.PutRequest(
            channel_id=one.channel.channel_id, epoch=one.channel.epoch, producer_id=7, puts=runs
        )
        if transport == "grpc":
            call: Any = one.channel.rig.channels.Put()
            await call.write(request)
        else:
            one.producer.send(request.SerializeToString())
        ahead, rest = (await one.feed.until_written(count + 2))[count:]
        assert [item.item.seq for item in items_in([ahead])] == [2]
        assert [(part.fields.state.first_seq, len(part.runs)) for part in parts_in([rest])] == [(4, 2)]
        assert next_seqs == [8]
        one.answer()
        if transport == "grpc":
            acks = [ack async for ack in acks_of(call, 3)]
            await call.done_writing()
        else:
            acks = one.acks()[1:]
        assert [(ack.first_seq, ack.items, ack.copies) for ack in acks] == [(2, 2, 2), (4, 2, 2), (6, 2, 2)]


async def acks_of(call: Any, count: int) -> AsyncIterator[channel_pb.PutAck]:
    """Yield the next acks of a stream, at least `count`."""
    while count > 0:
        for ack in (await call.read()).acks:
            count -= 1
            yield ack


async def test_a_run_of_which_the_channel_refuses_an_item_goes_to_the_replica_when_it_is_stored() -> None:
    async with fed(takes_items=True, takes_runs=True, max_bytes=1000) as one:
        begin(one)
        [part] = parts_in(one.put(b"a", bytes(2000), b"c"))
        assert (part.fields.state.first_seq, part.fields.state.next_seq) == (2, 4)


def fail_to_store(one: Fed, monkeypatch: pytest.MonkeyPatch) -> pb.FeedPlace:
    """Put an item that goes to the replica, and that a defect keeps the owner from storing. Returns the replica's place
    after it."""

    def fail(*_: object) -> None:
        raise RuntimeError("a defect")

    with monkeypatch.context() as patch:
        patch.setattr(Holdings, "store", fail)
        [item] = items_in(one.put())
    assert one.hosted.core.next_seq == item.item.seq
    core, epoch = one.hosted.core, one.hosted.epoch
    return pb.FeedPlace(incarnation=core.incarnation, next_seq=item.item.end_seq, owner_epoch=epoch)


async def test_a_replica_that_has_got_an_item_which_the_owner_could_not_store_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with fed(takes_items=True) as one:
        begin(one)
        replication = one.hosted.replication
        assert replication is not None
        place = fail_to_store(one, monkeypatch)
        assert not replication.is_fed(REPLICA), "no report of the replica counts any more"
        assert has_others_items(one.hosted, pb.FeedOpen(host_id=REPLICA, place=place))
        await pauses()


async def test_if_the_feed_breaks_before_a_replica_has_begun_anew_the_next_feed_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, the owner had then forgotten that the replica must begin anew.

    So the replica kept an item that the owner lacked.
    """
    async with fed(takes_items=True) as one:
        begin(one)
        replication = one.hosted.replication
        assert replication is not None
        place = fail_to_store(one, monkeypatch)
        await pauses()
        sockets = one.channel.rig.sockets
        one.producer = await held_stream(sockets, "/stampede_rt.v1.ChannelService/Put")
        for next_seq in (3, 4):  # the owner has another item under the last seq of the replica
            one.put()
            await pauses()
            assert one.hosted.core.next_seq == next_seq
        opening = pb.FeedOpen(
            channel_id=one.channel.channel_id, epoch=one.channel.epoch, host_id=REPLICA, target="replica:1",
            owner_facts=True, takes_puts=True, takes_items=True, place=place,
        )  # fmt: skip
        for breaks in (True, True, False):
            feed = await held_stream(sockets, "/stampede_rt.v1.ReplicaService/Feed")
            feed.send(pb.FeedRequest(open=opening, credit_bytes=2**20, sent_nanos=1).SerializeToString())
            await pauses()
            # The directory notes that the replica is out of sync, or in sync again.
            for change in replication.changes():
                replication.confirm(change)
            [opened, *_] = parts_in(await feed.until_written(1))
            assert opened.fields.opened.begins_anew
            await pauses()
            if not breaks:
                feed.send(pb.FeedRequest(held_next_seq=1, sent_nanos=2).SerializeToString())
            assert replication.diverged_host_ids == ({REPLICA} if breaks else set())
            feed.close()
            await pauses()


async def test_the_owner_remembers_a_diverged_replica_when_the_channel_gets_another_kind_of_replicas(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, the replica kept an item that the owner does not have."""
    async with fed(takes_items=True) as one:
        begin(one)
        place = fail_to_store(one, monkeypatch)
        record = one.hosted.record
        policy = replace(record.policy, ack="host")
        store = one.channel.rig.host.store
        store.adopt(replace(record, spec_version=record.spec_version + 1, policy=policy))
        continued = store.known(record.channel_id)
        assert continued is not None
        assert continued is not one.hosted
        assert has_others_items(continued, pb.FeedOpen(host_id=REPLICA, place=place))
        await pauses()


@pytest.mark.parametrize("reason", ["a late item", "two items", "no producer", "an unknown producer"])
async def test_other_puts_go_to_the_replica_when_they_are_stored(reason: str) -> None:
    async with fed(takes_items=True) as one:
        begin(one)
        payloads = (b"x", b"y") if reason == "two items" else (b"x",)
        producer_id = {"no producer": 0, "an unknown producer": 8}.get(reason, 7)
        times = [one.hosted.core.newest - 1] if reason == "a late item" and one.hosted.core.newest is not None else None
        head = put_head(one.channel.channel_id, one.channel.epoch, producer_id)
        count = len(one.feed.written())
        one.producer.send(put_request(head, 2, run_parts(payloads, times=times), 10**9))
        assert items_in(one.feed.written()[count:]) == []
        assert len(parts_in(one.feed.written()[count:])) == 1
