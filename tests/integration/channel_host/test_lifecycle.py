"""A channel host's gatekeeper, its epochs and fences, and its shutdown, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.errors import ChannelNotFound, StaleBinding, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_pb2, error_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt_channel_host.core.channel import run_to_end
from tests.support.channel_host.rig import FOREVER, HOST_ID, OpenedChannel, Rig, S, run_of, running_host
from tests.support.clock import ManualClock

REQUEST_ID = b"0123456789abcdef"


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    async with running_host() as rig:
        yield rig


async def refusal(call: Any) -> StampedeError:
    """The error that a call or stream ends with."""
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await asyncio.wait_for(_to_the_end(call), 45)
    return from_rpc_error(caught.value, "the host")


async def _to_the_end(call: Any) -> None:
    if isinstance(call, grpc.aio.UnaryUnaryCall):
        await call
    else:
        while await call.read() is not grpc.aio.EOF:
            pass


async def subscribed(channel: OpenedChannel) -> Any:
    call = channel.subscribe()
    async with asyncio.timeout(45):
        assert (await call.read()).HasField("opened")
    return call


async def blocked(channel: OpenedChannel) -> Any:
    call = channel.rig.channels.Get()
    await call.write(channel.newest_request(1, wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    return call


def bind(channel: OpenedChannel, **fields: Any) -> Any:
    fields = {"channel_id": channel.channel_id, "epoch": channel.epoch, **fields}
    return channel.rig.gate.BindChannel(gate_pb.BindChannelRequest(**fields))


async def test_the_gatekeeper_answers_with_its_clock_and_its_host(rig: Rig) -> None:
    answer = await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())
    assert (answer.host_id, answer.name, answer.lease_held) == (HOST_ID, "h1", True)
    assert answer.version
    assert answer.time_unix_nano <= rig.now()


async def test_binding_gives_the_data_endpoint_and_asks_the_directory_once(rig: Rig) -> None:
    channel = await rig.open()
    answers = await asyncio.gather(*(bind(channel) for _ in range(20)))
    assert [(one.transport, one.target) for one in answers[0].endpoints] == [(gate_pb.TRANSPORT_GRPC, rig.target)]
    assert answers[0].channel == rig.directory.channels[channel.channel_id]
    assert rig.directory.calls["ResolveChannel"] == 1


async def test_twenty_simultaneous_first_binds_ask_the_directory_once(rig: Rig) -> None:
    record = rig.directory.add_channel("fresh", HOST_ID)
    await asyncio.gather(*(bind(OpenedChannel(rig, record)) for _ in range(20)))
    assert rig.directory.calls["ResolveChannel"] == 1


async def test_an_unknown_channel_cannot_be_bound(rig: Rig) -> None:
    channel = await rig.open()
    assert (await refusal(bind(channel, channel_id=b"x" * 16))).reason == "CHANNEL_NOT_FOUND"
    assert (await refusal(bind(channel, channel_id=b"short"))).reason == "INVALID_ARGUMENT"


async def test_a_channel_of_another_host_cannot_be_bound(rig: Rig) -> None:
    record = rig.directory.add_channel("elsewhere", b"another-host-16b")
    error = await refusal(bind(OpenedChannel(rig, record)))
    assert (error.reason, error.metadata["host_id"]) == ("MOVED", b"another-host-16b".hex())


async def test_a_wrong_epoch_is_refused_with_the_right_one(rig: Rig) -> None:
    channel = await rig.open()
    error = await refusal(bind(channel, epoch=9))
    assert (error.reason, error.metadata["epoch"]) == ("WRONG_EPOCH", "1")


async def test_a_bind_fails_with_the_reason_if_the_directory_cannot_answer(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt_channel_host.cluster.directory.CALL_SECONDS_MAX", 0.5)
    record = rig.directory.add_channel("a", HOST_ID)
    rig.directory.refuse["ResolveChannel"] = Unavailable("no majority")
    error = await refusal(bind(OpenedChannel(rig, record)))
    assert error.reason in ("NO_QUORUM", "DEADLINE_EXCEEDED")  # the host's last try may have hardly any time left


async def test_readers_learn_at_the_next_bind_that_their_channel_has_moved(rig: Rig) -> None:
    channel = await rig.open()
    subscription, get = await subscribed(channel), await blocked(channel)
    rig.directory.move_away(channel.channel_id)
    assert (await refusal(bind(channel, epoch=2))).reason == "MOVED"
    assert (await refusal(subscription)).reason == "MOVED"
    assert (await get.read()).error.reason == error_pb2.ERROR_REASON_MOVED
    (ack,) = await channel.put(run_of(b"x"))
    assert ack.error.reason == error_pb2.ERROR_REASON_NOT_HERE


async def test_a_new_epoch_of_the_same_incarnation_keeps_the_items(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(run_of(b"x"))
    rig.directory.channels[channel.channel_id].epoch = 2
    await bind(channel, epoch=2)
    assert (await channel.get()).error.reason == error_pb2.ERROR_REASON_WRONG_EPOCH
    channel.epoch = 2
    assert (await channel.get()).payloads == [b"x"]


async def test_a_channel_that_a_registration_did_not_name_is_served_only_after_the_next_bind(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(run_of(b"x"))
    run_to_end(rig.host.store.registering([], is_complete=False))
    for epoch in (1, 0):
        channel.epoch = epoch
        assert (await channel.get()).error.reason == error_pb2.ERROR_REASON_NOT_HERE
    with pytest.raises(StaleBinding):
        rig.host.store.find_any_epoch(channel.channel_id)
    channel.epoch = 1
    await bind(channel, epoch=1)
    assert (await channel.get()).payloads == [b"x"]


async def test_a_new_incarnation_begins_empty_and_its_readers_get_an_error(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(run_of(b"x"))
    subscription = await subscribed(channel)
    record = rig.directory.channels[channel.channel_id]
    record.epoch, record.incarnation = 2, 999
    await bind(channel, epoch=2)
    assert (await refusal(subscription)).reason == "WRONG_EPOCH"
    channel.epoch = 2
    got = await channel.get()
    assert (got.payloads, got.summary.incarnation) == ([], 999)


async def test_dropping_a_channel_informs_its_readers_and_the_directory(rig: Rig) -> None:
    channel = await rig.open()
    subscription, get = await subscribed(channel), await blocked(channel)
    request = gate_pb.DropChannelRequest(request_id=REQUEST_ID, channel_id=channel.channel_id, epoch=channel.epoch)
    await rig.gate.DropChannel(request)
    assert (await refusal(subscription)).reason == "CHANNEL_NOT_FOUND"
    assert (await get.read()).error.reason == error_pb2.ERROR_REASON_CHANNEL_NOT_FOUND
    assert channel.channel_id not in rig.directory.channels
    (ack,) = await channel.put(run_of(b"x"))
    assert ack.error.reason == error_pb2.ERROR_REASON_NOT_HERE
    await rig.gate.DropChannel(request)  # repeated: the same answer
    request.request_id = REQUEST_ID[::-1]
    assert isinstance(await refusal(rig.gate.DropChannel(request)), ChannelNotFound)
    request.request_id = b""
    assert (await refusal(rig.gate.DropChannel(request))).reason == "INVALID_ARGUMENT"


async def test_configuring_a_channel_changes_it_here_and_in_the_directory(rig: Rig) -> None:
    channel = await rig.open()
    await channel.put(*(run_of(b"%d" % n, number=n) for n in range(1, 6)))
    request = gate_pb.ConfigureChannelRequest(
        request_id=REQUEST_ID,
        channel_id=channel.channel_id,
        epoch=channel.epoch,
        spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=2)),
    )
    answer = await rig.gate.ConfigureChannel(request)
    assert answer.channel.spec.retention.max_items == 2
    assert answer.channel.spec_version == 2
    assert rig.directory.channels[channel.channel_id].spec == answer.channel.spec
    assert (await channel.get()).payloads == [b"4", b"5"]
    request.epoch = 7
    assert (await refusal(rig.gate.ConfigureChannel(request))).reason == "WRONG_EPOCH"


async def test_a_host_passes_on_the_fields_of_a_record_that_it_does_not_know(rig: Rig) -> None:
    newer_field = b"\xfa\xff\x03\x03new"
    channel = await rig.open()
    record = rig.directory.channels[channel.channel_id]
    record.MergeFromString(newer_field)
    record.spec_version += 1
    request = gate_pb.BindChannelRequest(
        channel_id=channel.channel_id, epoch=channel.epoch, spec_version=record.spec_version
    )
    bound = await rig.gate.BindChannel(request)
    assert bound.channel.SerializeToString() == record.SerializeToString()
    assert newer_field in bound.channel.SerializeToString()


async def test_the_host_passes_an_unknown_value_of_a_policy_on_to_the_directory(rig: Rig) -> None:
    channel = await rig.open()
    request = gate_pb.ConfigureChannelRequest(
        request_id=REQUEST_ID, channel_id=channel.channel_id, epoch=channel.epoch,
        spec=channel_pb2.ChannelSpec(on_full=77),
    )  # fmt: skip
    await rig.gate.ConfigureChannel(request)
    assert rig.directory.channels[channel.channel_id].spec.on_full == 77


async def test_a_host_takes_a_newer_spec_from_the_bind_that_names_it(rig: Rig) -> None:
    channel = await rig.open()
    record = rig.directory.channels[channel.channel_id]
    record.spec.max_item_bytes, record.spec_version = 3, 2
    assert (await bind(channel, spec_version=2)).channel.spec_version == 2
    (ack,) = await channel.put(run_of(b"four"))
    assert ack.rejections[0].error.reason == error_pb2.ERROR_REASON_ITEM_TOO_LARGE


async def test_hosted_channels_are_listed_by_name_page_by_page(rig: Rig) -> None:
    for name in ("b", "cam/2", "a", "cam/1"):
        await (await rig.open(name)).put(run_of(b"x"))

    async def names(**fields: Any) -> tuple[list[str], str]:
        page = await rig.gate.ListHostedChannels(gate_pb.ListHostedChannelsRequest(**fields))
        assert all(one.counters.accepted == 1 for one in page.channels)
        return [one.record.name for one in page.channels], page.next_page_token

    assert await names() == (["a", "b", "cam/1", "cam/2"], "")
    assert await names(name_glob="cam/*") == (["cam/1", "cam/2"], "")
    assert await names(name_glob="?") == (["a", "b"], "")
    first, token = await names(page_size=3)
    assert first == ["a", "b", "cam/1"]
    assert await names(page_size=3, page_token=token) == (["cam/2"], "")
    assert (await refusal(rig.gate.ListHostedChannels(gate_pb.ListHostedChannelsRequest(name_glob="*" * 999)))).reason


async def test_a_fenced_host_refuses_all_calls_and_ends_the_streams_of_its_readers() -> None:
    clock = ManualClock()
    async with running_host(clock=clock, lease_ttl_nanos=3 * S) as rig:
        channel = await rig.open()
        subscription, get = await subscribed(channel), await blocked(channel)
        rig.directory.refuse["RenewHostLease"] = Unavailable("no majority")
        clock.advance(3 * S)
        (ack,) = await channel.put(run_of(b"x"))
        assert ack.error.reason == error_pb2.ERROR_REASON_NOT_HERE
        assert "could not renew its lease" in ack.error.message
        assert (await refusal(bind(channel))).reason == "NOT_HERE"
        assert (await refusal(channel.subscribe())).reason == "NOT_HERE"
        assert (await refusal(rig.channels.GetChannelStatus(pb.GetChannelStatusRequest()))).reason == "NOT_HERE"
        assert not (await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())).lease_held
        assert (await refusal(subscription)).reason == "NOT_HERE"
        assert (await get.read()).error.reason == error_pb2.ERROR_REASON_NOT_HERE


async def test_a_host_that_shuts_down_ends_all_streams_with_a_reason_and_deregisters(rig: Rig) -> None:
    channel = await rig.open()
    subscription, get = await subscribed(channel), await blocked(channel)
    put = rig.channels.Put()
    await put.write(pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"x")]))
    assert (await get.read()).call_id == 1
    await get.write(channel.get_request(2, interval=channel.future(), wait_nanos=FOREVER))
    await channel.until(lambda status: status.waiting_gets == 1)
    await rig.host.leave()
    assert (await refusal(subscription)).reason == "SHUTTING_DOWN"
    assert (await get.read()).error.reason == error_pb2.ERROR_REASON_SHUTTING_DOWN
    assert (await refusal(get)).reason == "SHUTTING_DOWN"
    assert (await refusal(put)).reason == "SHUTTING_DOWN"
    assert (await refusal(channel.subscribe())).reason == "SHUTTING_DOWN"
    assert not rig.directory.hosts[HOST_ID].alive


async def test_a_host_that_registers_again_drops_the_channels_that_have_moved_away() -> None:
    async with running_host(lease_ttl_nanos=3 * S) as rig:
        kept, lost = await rig.open("kept"), await rig.open("lost")
        await kept.put(run_of(b"x"))
        rig.directory.move_away(lost.channel_id)
        registered = rig.directory.calls["RegisterHost"]
        rig.directory.lease_ttl_nanos = 600 * S  # so long that even a busy machine keeps the next lease
        rig.directory.hosts[HOST_ID].alive = False
        await rig.directory.called("RegisterHost", times=registered + 1)
        async with asyncio.timeout(30):
            while not (await rig.gate.Ping(gate_pb.GatekeeperServicePingRequest())).lease_held:
                pass
        assert (await kept.get()).payloads == [b"x"]
        assert (await lost.get()).error.reason == error_pb2.ERROR_REASON_NOT_HERE


async def test_the_stream_of_a_vanished_caller_is_removed(rig: Rig) -> None:
    channel = await rig.open()
    for call in (await subscribed(channel), await blocked(channel)):
        call.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await call.read()
    await channel.until(lambda status: (status.subscriptions, status.waiting_gets) == (0, 0))


async def test_a_waiting_put_fails_when_its_channel_is_dropped(rig: Rig) -> None:
    retention = channel_pb2.RetentionPolicy(max_items=1, max_age_nanos=600 * S)
    channel = await rig.open(spec=channel_pb2.ChannelSpec(retention=retention, on_full=channel_pb2.ON_FULL_BLOCK))
    putting = asyncio.create_task(channel.put(run_of(b"x"), run_of(b"y", number=2)))
    await channel.until(lambda status: status.waiting_puts == 1)
    await rig.gate.DropChannel(
        gate_pb.DropChannelRequest(request_id=REQUEST_ID, channel_id=channel.channel_id, epoch=channel.epoch)
    )
    first, second = await putting
    assert first.first_seq == 1
    assert second.error.reason == error_pb2.ERROR_REASON_CHANNEL_NOT_FOUND


async def test_a_policy_that_the_host_cannot_hold_is_refused_before_the_directory_changes(rig: Rig) -> None:
    channel = await rig.open()
    spec = channel_pb2.ChannelSpec(
        retention=channel_pb2.RetentionPolicy(max_items=1), on_full=channel_pb2.ON_FULL_BLOCK
    )
    request = gate_pb.ConfigureChannelRequest(
        request_id=REQUEST_ID, channel_id=channel.channel_id, epoch=channel.epoch, spec=spec
    )
    assert (await refusal(rig.gate.ConfigureChannel(request))).reason == "INVALID_ARGUMENT"
    assert rig.directory.calls["UpdateChannel"] == 0
