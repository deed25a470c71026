"""Over a socket a host answers single puts and short gets in the same turn of the event loop in which they arrive."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.status import from_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.policy import parse_policy
from stampede_rt.wire.put_frames import put_head, put_request
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.request_pieces import messages_of
from stampede_rt.wire.runs import run_parts
from stampede_rt.wire.stream_frames import FrameKind, frame_of
from stampede_rt_runtime import pacing
from tests.support.channel_host.held_transport import HeldStream, held_stream
from tests.support.channel_host.rig import OpenedChannel, run_of, running_host

SERVICE = "/stampede_rt.v1.ChannelService"
PRODUCER = 7


@pytest.fixture(autouse=True)
def unlimited_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Remove the time budget of a turn: on a busy machine one answer may take longer."""
    monkeypatch.setattr(pacing, "SAME_TURN_NANOS", 2**62)


@asynccontextmanager
async def stream_of(method: str, **policy: object) -> AsyncIterator[tuple[HeldStream, OpenedChannel]]:
    """Yield a stream and a channel."""
    async with running_host() as rig:
        channel = await rig.open("a", policy_to_spec(parse_policy(**policy)))  # type: ignore[arg-type]
        stream = await held_stream(rig.sockets, f"{SERVICE}/{method}")
        yield stream, channel
        stream.close()


def put_of(channel: OpenedChannel, number: int, payload: bytes = b"x", *, epoch: int | None = None) -> bytes:
    head = put_head(channel.channel_id, channel.epoch if epoch is None else epoch, PRODUCER)
    return put_request(head, number, run_parts((payload,), times=None), 10**9)


def acks_in(messages: list[bytes]) -> list[pb.PutAck]:
    return [ack for message in messages for ack in pb.PutResponse.FromString(message).acks]


def newest(channel: OpenedChannel, call_id: int, **fields: object) -> bytes:
    return channel.newest_request(call_id, **fields).SerializeToString()


async def test_a_single_put_is_acked_in_the_turn_in_which_it_arrives() -> None:
    async with stream_of("Put") as (stream, channel):
        for number in (1, 2, 3):
            [ack] = acks_in(stream.send(put_of(channel, number)))
            assert (ack.first_number, ack.first_seq, ack.HasField("error")) == (number, number, False)
        assert (await channel.get()).payloads == [b"x"] * 3


@pytest.mark.parametrize("payload_bytes", [4096, 18_000, 250_000])
async def test_a_put_of_one_long_message_is_acked_in_the_turn_in_which_its_last_bytes_arrive(
    payload_bytes: int,
) -> None:
    async with stream_of("Put") as (stream, channel):
        payloads = [bytes([number]) * (payload_bytes - number) for number in range(1, 4)]
        for number, payload in enumerate(payloads, start=1):
            [ack] = acks_in(stream.send(put_of(channel, number, payload)))
            assert ack.first_seq == number
        assert (await channel.get()).payloads == payloads


@pytest.mark.parametrize(("runs", "is_in_same_turn"), [(16, True), (17, False)])
async def test_a_request_of_a_few_runs_is_acked_in_the_turn_in_which_it_arrives(
    runs: int, is_in_same_turn: bool
) -> None:
    async with stream_of("Put") as (stream, channel):
        head, run = put_head(channel.channel_id, channel.epoch, PRODUCER), run_parts((bytes(3000),), times=None)
        request = head + b"".join(put_request(b"", number, run, 10**9) for number in range(1, runs + 1))
        found = acks_in(stream.send(request))
        assert bool(found) == is_in_same_turn
        while len(found) < runs:
            found = acks_in(await stream.until_written(1))
        assert [ack.first_seq for ack in found] == [*range(1, runs + 1)]


@pytest.mark.parametrize(("items", "is_in_same_turn"), [(64, True), (65, False)])
async def test_a_turn_judges_a_bounded_number_of_items_with_times(items: int, is_in_same_turn: bool) -> None:
    """In an earlier version, one turn judged 16 full runs, which took up to 0.1 s."""
    async with stream_of("Put") as (stream, channel):
        request, runs, numbers = put_head(channel.channel_id, channel.epoch, PRODUCER), 16, range(1, 16 * items, items)
        for number in numbers:
            run = run_parts((b"x",) * items, times=[*range(number, number + items)])
            request += put_request(b"", number, run, 10**9)
        found = acks_in(stream.send(request))
        assert bool(found) == is_in_same_turn
        while len(found) < runs:
            await stream.until_written(len(stream.written()) + 1)
            found = acks_in(stream.written())
        assert [ack.first_seq for ack in found] == [*numbers]


async def test_a_repeated_put_gets_its_former_ack_immediately() -> None:
    async with stream_of("Put") as (stream, channel):
        former = stream.send(put_of(channel, 1))
        assert acks_in(stream.send(put_of(channel, 1)))[0].first_seq == acks_in(former)[0].first_seq == 1


async def test_a_put_into_another_epoch_is_refused_and_does_not_end_the_stream() -> None:
    async with stream_of("Put") as (stream, channel):
        assert stream.send(put_of(channel, 1, epoch=9)) == []
        [refusal] = acks_in(await stream.until_written(1))
        assert refusal.HasField("error")
        assert acks_in(stream.send(put_of(channel, 2)))[0].first_seq == 1


async def test_puts_that_arrive_together_are_acked_together_and_in_order() -> None:
    async with stream_of("Put") as (stream, channel):
        assert stream.send(*(put_of(channel, number) for number in range(1, 30))) == []
        assert acks_in(stream.send(put_of(channel, 30))) == [], "the acks of earlier puts come first"
        while len(acks := acks_in(stream.written())) < 30:
            await stream.until_written(len(stream.written()) + 1)
        assert [ack.first_seq for ack in acks] == list(range(1, 31))
        assert acks_in(stream.send(put_of(channel, 31)))[0].first_seq == 31


async def test_runs_of_a_producer_that_arrive_one_by_one_are_acked_immediately() -> None:
    async with stream_of("Put") as (stream, channel):
        assert acks_in(stream.send(put_of(channel, 1)))[0].first_seq == 1
        for number in (2, 3):
            [ack] = acks_in(stream.send(put_request(b"", number, run_parts((b"x",), times=None), 10**9)))
            assert (ack.first_number, ack.first_seq) == (number, number)


async def test_a_first_run_that_names_no_channel_is_refused() -> None:
    async with stream_of("Put") as (stream, _):
        assert stream.send(put_request(b"", 1, run_parts((b"x",), times=None), 10**9)) == []
        [refusal] = acks_in(await stream.until_written(1))
        assert "names no channel" in refusal.error.message


async def test_a_put_that_may_wait_for_room_is_passed_to_the_stream() -> None:
    policy = {"max_items": 1, "max_age": "10s", "on_full": "block"}
    async with stream_of("Put", **policy) as (stream, channel):
        assert stream.send(put_of(channel, 1)) == []
        assert acks_in(await stream.until_written(1))[0].first_seq == 1
        assert stream.send(put_of(channel, 2)) == [], "the channel has no room"
        assert stream.send(put_of(channel, 3)) == [], "the second put must be answered first"


async def test_a_put_between_the_pieces_of_another_request_is_refused() -> None:
    async with stream_of("Put") as (stream, channel):
        pieces = list(messages_of(put_of(channel, 1, bytes(400_000))))
        assert stream.send(pieces[0]) == []
        assert stream.send(put_of(channel, 2)) == []
        [status] = await stream.until_written(1)
        assert b"holds something else" in status


async def test_the_newest_item_is_read_in_the_turn_in_which_the_request_arrives() -> None:
    async with stream_of("Get") as (stream, channel):
        for call_id, payload in ((1, b"small"), (2, bytes(200_000))):
            await channel.put(run_of(payload, number=call_id))
            [message] = stream.send(newest(channel, call_id))
            response = pb.GetResponse.FromString(message)
            assert (response.call_id, response.runs[0].run.payloads) == (call_id, payload)
            assert response.HasField("summary")


async def test_an_answer_of_several_messages_begins_immediately_and_is_complete() -> None:
    async with stream_of("Get") as (stream, channel):
        for number in range(1, 8):
            await channel.put(run_of(bytes(300_000), number=number))
        [first] = stream.send(channel.get_request(1).SerializeToString())
        assert not pb.GetResponse.FromString(first).HasField("summary")
        responses = [pb.GetResponse.FromString(one) for one in await stream.until_written(3)]
        assert sum(len(one.runs) for one in responses) == 7
        assert [one.HasField("summary") for one in responses] == [False, False, True]


async def test_a_get_after_a_waiting_one_is_passed_to_the_stream_and_answered() -> None:
    async with stream_of("Get") as (stream, channel):
        assert stream.send(newest(channel, 1, wait_nanos=-1)) == []
        assert stream.send(newest(channel, 2)) == []
        [second] = await stream.until_written(1)
        assert pb.GetResponse.FromString(second).call_id == 2
        await channel.put(run_of(b"x", number=1))
        assert pb.GetResponse.FromString((await stream.until_written(2))[1]).call_id == 1


@pytest.mark.parametrize("method", ["Put", "Get"])
async def test_a_message_that_cannot_be_decoded_ends_the_stream(method: str) -> None:
    async with stream_of(method) as (stream, _):
        assert stream.send(b"\xff\xff") == []
        [status] = await stream.until_written(1)
        assert f"not a valid {method}Request message".encode() in status


async def test_messages_beyond_the_budget_of_a_turn_are_answered_later_and_the_next_turn_has_a_new_budget(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with stream_of("Put") as (stream, channel):
        monkeypatch.setattr(pacing, "SAME_TURN_NANOS", -(2**62))
        assert stream.send(put_of(channel, 1)) == []
        assert acks_in(await stream.until_written(1))[0].first_seq == 1
        monkeypatch.setattr(pacing, "SAME_TURN_NANOS", 2**62)
        assert acks_in(stream.send(put_of(channel, 2)))[0].first_seq == 2


async def test_a_half_close_after_a_put_ends_the_stream_after_the_ack() -> None:
    async with stream_of("Put") as (stream, channel):
        stream.send_frames(frame_of(FrameKind.MESSAGE, put_of(channel, 1)) + frame_of(FrameKind.END))
        ack, status = await stream.until_written(2)
        assert (acks_in([ack])[0].first_seq, status) == (1, b"")


@pytest.mark.parametrize("runs", [3, 20], ids=["in the same turn", "by the task of the stream"])
async def test_no_run_of_a_producer_overtakes_a_refused_run_that_the_producer_sends_again(runs: int) -> None:
    async with stream_of("Put") as (stream, channel):
        puts = channel.rig.host.store.find(channel.channel_id, channel.epoch).puts
        refusals = iter([Overloaded("there is no memory")])

        def check_room(_: int) -> None:
            if (error := next(refusals, None)) is not None:
                raise error

        puts.check_room = check_room
        later = [put_request(b"", number, run_parts((b"later",), times=None), 0) for number in range(2, runs + 1)]
        first = put_request(b"", 1, run_parts((b"first",), times=None), 0)
        head = put_head(channel.channel_id, channel.epoch, PRODUCER)
        written = len(stream.written())
        stream.send(head + first + b"".join(later))
        stream.send(put_request(b"", runs + 1, run_parts((b"later",), times=None), 0))
        while len(acks := acks_in(stream.written()[written:])) < runs + 1:
            await stream.until_written(len(stream.written()) + 1)
        assert {from_error_message(ack.error).reason for ack in acks} == {"OVERLOADED"}
        stream.send(first)
        stream.send(b"".join(later[:2]))
        while len(acks := acks_in(stream.written()[written:])) < runs + 4:
            await stream.until_written(len(stream.written()) + 1)
        assert [ack.first_seq for ack in acks[-3:]] == [1, 2, 3]
        assert (await channel.get()).payloads == [b"first", b"later", b"later"]


async def test_a_refused_put_does_not_refuse_a_later_put_that_names_its_channel() -> None:
    async with stream_of("Put") as (stream, channel):
        puts = channel.rig.host.store.find(channel.channel_id, channel.epoch).puts
        refusals = iter([Overloaded("there is no memory")])

        def check_room(_: int) -> None:
            if (error := next(refusals, None)) is not None:
                raise error

        puts.check_room = check_room
        [refusal] = acks_in(stream.send(put_of(channel, 1)))
        assert from_error_message(refusal.error).reason == "OVERLOADED"
        assert acks_in(stream.send(put_of(channel, 2)))[0].first_seq == 1
