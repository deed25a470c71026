"""Puts into a channel host, over gRPC with the generated stubs."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator

import pytest

from stampede_rt.v1 import channel_pb2, error_pb2, item_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.cluster.records import policy_change
from tests.support.channel_host.rig import MS, OpenedChannel, Rig, S, run_of, running_host
from tests.support.waiting import until


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def test_a_run_without_times_is_stamped_by_the_host(rig: Rig) -> None:
    channel = await rig.open()
    before = rig.now()
    (ack,) = await channel.put(run_of(b"one", b"two", number=1))
    assert (ack.first_number, ack.items, ack.first_seq) == (1, 2, 1)
    assert before <= ack.stamped_unix_nano <= rig.now()
    assert ack.incarnation == channel.incarnation
    assert ack.host_time_unix_nano >= before
    got = await channel.get()
    assert got.payloads == [b"one", b"two"]
    assert got.times == [ack.stamped_unix_nano] * 2


async def test_a_run_with_times_keeps_them(rig: Rig) -> None:
    channel = await rig.open()
    now = rig.now()
    (ack,) = await channel.put(run_of(b"x", b"yy", times=[now - 2, now - 1], durations=[5, -1]))
    assert not ack.HasField("stamped_unix_nano")
    got = await channel.get()
    assert got.times == [now - 2, now - 1]
    assert list(got.runs[0].run.duration_nanos) == [5, -1]
    assert got.runs[0].run.first_seq == 1


async def test_runs_of_256_items_are_stored_and_sent_as_they_came(rig: Rig) -> None:
    channel = await rig.open()
    now = rig.now()
    runs = [
        run_of(*(b"%d" % n for n in range(256)), times=[now - S + place * 256 + n for n in range(256)], number=1)
        for place in range(4)
    ]
    acks = await channel.put(*runs)
    assert [ack.first_seq for ack in acks] == [1, 257, 513, 769]
    got = await channel.get()
    assert len(got.payloads) == 1024
    assert [delivered.run.first_seq for delivered in got.runs] == [1, 257, 513, 769]
    assert got.summary.incarnation == channel.incarnation


async def test_refused_items_of_a_run_do_not_delay_its_other_items(rig: Rig) -> None:
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_age_nanos=S)))
    now = rig.now()
    await channel.put(run_of(b"first", times=[now - 1]))
    (ack,) = await channel.put(
        run_of(b"old", b"good", b"ahead", times=[now - 5 * S, now, now + 60 * S], durations=[0, -1, -1])
    )
    assert ack.first_seq == 2
    refused = [(one.index, one.error.reason) for one in ack.rejections]
    assert refused == [(0, error_pb2.ERROR_REASON_TOO_OLD), (2, error_pb2.ERROR_REASON_IN_FUTURE)]
    assert "offset_nanos" in ack.rejections[1].error.metadata
    assert (await channel.get()).payloads == [b"first", b"good"]
    counters = (await channel.status()).counters
    assert (counters.accepted, counters.rejected_too_old, counters.rejected_in_future) == (2, 1, 1)


async def test_many_runs_on_one_stream_are_acked_in_order(rig: Rig) -> None:
    channel = await rig.open()
    call = rig.channels.Put()
    await call.write(pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"0", number=1)]))
    for number in range(2, 101):
        await call.write(pb.PutRequest(puts=[run_of(b"x", number=number)]))
    await call.done_writing()
    acks = [ack async for response in call for ack in response.acks]
    assert [ack.first_number for ack in acks] == list(range(1, 101))
    assert [ack.first_seq for ack in acks] == list(range(1, 101))


async def test_a_put_without_a_channel_is_refused_with_advice(rig: Rig) -> None:
    call = rig.channels.Put(iter((pb.PutRequest(puts=[run_of(b"x")]),)))
    acks = [ack async for response in call for ack in response.acks]
    assert acks[0].error.reason == error_pb2.ERROR_REASON_INVALID_ARGUMENT
    assert "channel_id" in acks[0].error.message


async def test_a_wrong_epoch_is_refused_for_each_run_and_does_not_end_the_stream(rig: Rig) -> None:
    channel = await rig.open()
    first, second = await channel.put(run_of(b"x"), run_of(b"y", number=2), epoch=channel.epoch + 1)
    assert first.error.reason == second.error.reason == error_pb2.ERROR_REASON_WRONG_EPOCH
    assert first.error.metadata["epoch"] == str(channel.epoch)
    assert (await channel.get()).payloads == []


async def test_an_unbound_channel_is_not_here(rig: Rig) -> None:
    channel = await rig.open()
    channel.channel_id = b"another-channel!"
    (ack,) = await channel.put(run_of(b"x"))
    assert ack.error.reason == error_pb2.ERROR_REASON_NOT_HERE


async def test_a_malformed_run_is_refused_and_counted_and_the_next_one_is_accepted(rig: Rig) -> None:
    channel = await rig.open()
    broken = pb.PutRun(first_number=1, run=item_pb2.ItemRun(payload_length_bytes=[3], payloads=b"four"))
    bad, good = await channel.put(broken, run_of(b"x", number=2))
    assert bad.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
    assert "add up to 3 bytes" in bad.error.message
    assert good.first_seq == 1
    assert (await channel.status()).counters.rejected_malformed == 1


async def test_a_run_with_a_seq_or_unknown_fields_is_refused(rig: Rig) -> None:
    channel = await rig.open()
    sealed = pb.PutRun(first_number=1, run=item_pb2.ItemRun(payload_length_bytes=[1], payloads=b"x", first_seq=9))
    (ack,) = await channel.put(sealed)
    assert ack.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN


async def test_garbage_instead_of_a_request_ends_the_stream_with_a_reason(rig: Rig) -> None:
    method = rig.connection.stream_stream("/stampede_rt.v1.ChannelService/Put")
    with pytest.raises(Exception, match="not a valid PutRequest"):
        [response async for response in method(iter((b"\xff\xff\xff",)))]


async def test_an_item_over_the_channels_limit_is_refused_and_counted(rig: Rig) -> None:
    channel = await rig.open(spec=channel_pb2.ChannelSpec(max_item_bytes=100))
    small, large = await channel.put(run_of(b"x" * 100), run_of(b"x" * 101, number=2))
    assert small.first_seq == 1
    assert [one.error.reason for one in large.rejections] == [error_pb2.ERROR_REASON_ITEM_TOO_LARGE]
    assert (await channel.status()).counters.rejected_too_large == 1


async def test_an_item_over_16_mib_is_refused_and_counted_as_too_large(rig: Rig) -> None:
    channel = await rig.open()
    (ack,) = await channel.put(run_of(b"x" * (16 * 2**20 + 1)))
    assert ack.error.reason == error_pb2.ERROR_REASON_ITEM_TOO_LARGE
    counters = (await channel.status()).counters
    assert (counters.rejected_too_large, counters.rejected_malformed) == (1, 0)


async def test_an_item_of_16_mib_is_accepted(rig: Rig) -> None:
    channel = await rig.open()
    (ack,) = await channel.put(run_of(b"x" * (16 * 2**20)))
    assert ack.first_seq == 1
    assert [len(payload) for payload in (await channel.get()).payloads] == [16 * 2**20]


async def test_too_many_bytes_in_one_request_are_refused(rig: Rig) -> None:
    channel = await rig.open()
    acks = await channel.put(run_of(b"x" * (3 * 2**20)), run_of(b"x" * (3 * 2**20), number=2))
    assert {ack.error.reason for ack in acks} == {error_pb2.ERROR_REASON_INVALID_ARGUMENT}


async def test_a_retried_put_gets_its_first_answer_and_is_stored_once(rig: Rig) -> None:
    channel = await rig.open()
    (first,) = await channel.put(run_of(b"x", b"y", number=5), producer_id=77)
    (repeated,) = await channel.put(run_of(b"x", b"y", number=5), producer_id=77)
    assert repeated == first
    assert (await channel.status()).counters.accepted == 2
    (other,) = await channel.put(run_of(b"x", b"y", number=5), producer_id=78)
    assert other.first_seq == 3


async def test_a_producer_with_an_id_must_number_its_runs(rig: Rig) -> None:
    channel = await rig.open()
    (ack,) = await channel.put(run_of(b"x", number=0), producer_id=77)
    assert ack.error.reason == error_pb2.ERROR_REASON_INVALID_ARGUMENT


async def test_a_full_channel_that_rejects_refuses_a_put(rig: Rig) -> None:
    retention = channel_pb2.RetentionPolicy(max_items=1)
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=retention, on_full=channel_pb2.ON_FULL_REJECT))
    first, second = await channel.put(run_of(b"x"), run_of(b"y", number=2))
    assert first.first_seq == 1
    assert [one.error.reason for one in second.rejections] == [error_pb2.ERROR_REASON_CHANNEL_FULL]


def blocking(max_age_nanos: int) -> channel_pb2.ChannelSpec:
    retention = channel_pb2.RetentionPolicy(max_items=1, max_age_nanos=max_age_nanos)
    return channel_pb2.ChannelSpec(retention=retention, on_full=channel_pb2.ON_FULL_BLOCK)


async def test_a_blocked_put_does_not_delay_earlier_acks(rig: Rig) -> None:
    channel = await rig.open(spec=blocking(600 * S))
    call = rig.channels.Put()
    await call.write(
        pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"x"), run_of(b"y", number=2)])
    )
    response = await call.read()
    assert [ack.first_number for ack in response.acks] == [1]
    await channel.until(lambda status: status.waiting_puts == 1)
    await rig.host.changes.configure(
        channel.channel_id,
        channel.epoch,
        policy_change(channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=2))),
        b"0123456789abcdef",
        time.monotonic(),
    )
    response = await call.read()
    assert [(ack.first_number, ack.first_seq) for ack in response.acks] == [(2, 2)]
    call.cancel()


async def test_the_host_counts_the_memory_of_runs_that_wait_after_a_blocked_one(rig: Rig) -> None:
    channel = await rig.open(spec=blocking(600 * S))
    call = rig.channels.Put()
    puts = [run_of(b"x"), *(run_of(bytes(30_000), number=number) for number in range(2, 8))]
    await call.write(pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=puts))
    await channel.until(lambda status: status.waiting_puts == 1)
    assert 180_000 < rig.host.store.memory.used_bytes < 190_000
    call.cancel()
    await channel.until(lambda status: status.waiting_puts == 0)
    await until(lambda: rig.host.store.memory.used_bytes < 10_000)


async def test_a_blocked_put_is_accepted_when_the_oldest_item_has_reached_its_age(rig: Rig) -> None:
    channel = await rig.open(spec=blocking(50 * MS))
    now = rig.now()
    acks = await channel.put(*(run_of(b"x", times=[now + n * MS], number=n + 1) for n in range(3)))
    assert [ack.first_seq for ack in acks] == [1, 2, 3]
    assert (await channel.status()).counters.collected_by_age >= 2


async def test_a_blocked_put_fails_at_its_timeout(rig: Rig) -> None:
    channel = await rig.open(spec=blocking(600 * S))
    first, second = await channel.put(run_of(b"x"), run_of(b"y", number=2, wait_nanos=20 * MS))
    assert first.first_seq == 1
    assert [one.error.reason for one in second.rejections] == [error_pb2.ERROR_REASON_CHANNEL_FULL]
    status = await channel.status()
    assert (status.waiting_puts, status.counters.rejected_full) == (0, 1)


async def test_a_put_without_a_timeout_fails_immediately_and_a_later_one_waits(rig: Rig) -> None:
    channel = await rig.open(spec=blocking(600 * S))
    await channel.put(run_of(b"x"))
    waiting = rig.channels.Put()
    await waiting.write(
        pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"y", number=2)])
    )
    await channel.until(lambda status: status.waiting_puts == 1)
    (refused,) = await channel.put(run_of(b"z", wait_nanos=0))
    assert [one.error.reason for one in refused.rejections] == [error_pb2.ERROR_REASON_CHANNEL_FULL]
    waiting.cancel()
    await channel.until(lambda status: status.waiting_puts == 0)
    assert (await channel.status()).counters.accepted == 1


async def test_a_retried_put_is_recognised_while_others_wait_for_room(rig: Rig) -> None:
    """In an earlier version, the retry failed with CHANNEL_FULL, as if the host had not accepted the first put."""
    channel = await rig.open(spec=blocking(600 * S))
    (first,) = await channel.put(run_of(b"x", wait_nanos=0), producer_id=77)
    waiting = rig.channels.Put()
    await waiting.write(
        pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"y", number=2)])
    )
    await channel.until(lambda status: status.waiting_puts == 1)
    (repeated,) = await channel.put(run_of(b"x", wait_nanos=0), producer_id=77)
    assert repeated == first
    assert (await channel.status()).counters.rejected_full == 0
    waiting.cancel()


async def test_a_retry_of_a_partly_accepted_run_continues_at_its_position(rig: Rig) -> None:
    """In an earlier version, the host kept the refusal of the rest, and refused the retry, too, though the channel had
    room by then.
    """
    channel = await rig.open(spec=blocking(600 * S))
    waiting = rig.channels.Put()
    head = {"channel_id": channel.channel_id, "epoch": channel.epoch, "producer_id": 77}
    await waiting.write(pb.PutRequest(**head, puts=[run_of(b"x", b"y")]))
    await channel.until(lambda status: status.waiting_puts == 1)
    waiting.cancel()
    await channel.until(lambda status: status.waiting_puts == 0)
    await make_room(rig, channel)
    (other,) = await channel.put(run_of(b"z"))
    (repeated,) = await channel.put(run_of(b"x", b"y"), producer_id=77)
    assert (repeated.first_seq, other.first_seq, list(repeated.rejections)) == (1, 2, [])
    assert [(one.index, one.first_seq) for one in repeated.later_parts] == [(1, 3)]
    assert (await channel.put(run_of(b"x", b"y"), producer_id=77)) == [repeated]
    assert (await channel.status()).counters.accepted == 3


async def test_a_retry_of_a_partly_accepted_run_continues_after_a_lost_lease(rig: Rig) -> None:
    """In an earlier version, the host answered "resolve the channel again" for the rest, and again for the retry."""
    channel = await rig.open(spec=blocking(600 * S))
    waiting = rig.channels.Put()
    head = {"channel_id": channel.channel_id, "epoch": channel.epoch, "producer_id": 77}
    await waiting.write(pb.PutRequest(**head, puts=[run_of(b"x", b"y", b"z")]))
    await channel.until(lambda status: status.waiting_puts == 1)
    rig.host.store.fence()
    (ack,) = (await waiting.read()).acks
    assert ack.error.reason == error_pb2.ERROR_REASON_NOT_HERE, "the whole run is to be sent again"
    waiting.cancel()
    await make_room(rig, channel)
    (repeated,) = await channel.put(run_of(b"x", b"y", b"z"), producer_id=77)
    assert (repeated.first_seq, list(repeated.rejections), repeated.items) == (1, [], 3)
    assert (await channel.status()).counters.accepted == 3


async def make_room(rig: Rig, channel: OpenedChannel) -> None:
    """Give the channel another limit, and wait until the waiting puts are accepted."""
    request = blocking(600 * S)
    request.retention.max_items = 9
    await rig.host.changes.configure(
        channel.channel_id, channel.epoch, policy_change(request), b"0123456789abcdef", time.monotonic()
    )


async def test_the_rest_of_a_partly_accepted_run_is_refused_when_its_channel_is_dropped(rig: Rig) -> None:
    """In an earlier version, the ack said that the host had accepted none of the items."""
    channel = await rig.open(spec=blocking(600 * S))
    waiting = rig.channels.Put()
    await waiting.write(pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"x", b"y")]))
    await channel.until(lambda status: status.waiting_puts == 1)
    await rig.host.changes.drop(channel.channel_id, channel.epoch, b"0123456789abcdef", time.monotonic())
    (ack,) = (await waiting.read()).acks
    assert (ack.HasField("error"), ack.first_seq) == (False, 1)
    assert [one.error.reason for one in ack.rejections] == [error_pb2.ERROR_REASON_CHANNEL_NOT_FOUND]
    waiting.cancel()


async def test_puts_beyond_the_hosts_memory_are_refused() -> None:
    async with running_host(memory_bytes_max=10_000) as rig:
        channel, other = await rig.open("a"), await rig.open("b")
        (first,) = await channel.put(run_of(b"x" * 9_000))
        assert first.first_seq == 1
        (second,) = await other.put(run_of(b"x" * 2_000))
        assert second.error.reason == error_pb2.ERROR_REASON_OVERLOADED
        assert "--memory-bytes-max" in second.error.message
