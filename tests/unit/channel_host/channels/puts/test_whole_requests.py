"""Large requests come in pieces, which the host joins."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import pytest
from grpc.aio import EOF

from stampede_rt.errors import DeadlineExceeded, InvalidArgument, Overloaded
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX, messages_of
from stampede_rt_channel_host.channels.limits.request_room import RequestRooms
from stampede_rt_channel_host.channels.puts import whole_requests
from stampede_rt_channel_host.channels.puts.whole_requests import WholeRequests
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.limits import DEFAULTS, Quota
from stampede_rt_runtime.quotas.loop_shares import LoopShares
from tests.support.channel_host.rig import run_of, running_host


def stream_of(messages: Iterable[bytes], account: Account | None = None) -> tuple[WholeRequests, RequestRooms]:
    left, room = iter(messages), RequestRooms()

    async def read() -> Any:
        return next(left, EOF)

    return WholeRequests(read, room, account or unlimited()), room


def piece(content: bytes, request_bytes: int = 0) -> bytes:
    return pb.PutRequest(piece=pb.RequestPiece(request_bytes=request_bytes, content=content)).SerializeToString()


async def test_large_and_small_requests_arrive_complete_and_in_order() -> None:
    requests = [b"\x0asmall", b"\x0a" + bytes(3 * MESSAGE_BYTES_MAX), b"\x0alast"]
    whole, room = stream_of(message for request in requests for message in messages_of(request))
    assert [await whole.read() for _ in requests] == requests
    assert await whole.read() is EOF
    assert room.used_bytes == 0


async def test_a_joined_request_keeps_its_room_until_its_stream_lets_go_of_it() -> None:
    large = b"\x0a" + bytes(3 * MESSAGE_BYTES_MAX)
    whole, room = stream_of([*messages_of(large), *messages_of(large), b"\x0asmall"])
    await whole.read()
    assert room.used_bytes == len(large)
    whole.release()
    assert room.used_bytes == 0
    await whole.read()
    assert room.used_bytes == len(large)
    await whole.read()  # the next request
    assert room.used_bytes == 0


async def test_a_caller_beyond_its_share_waits_for_a_turn_before_each_further_piece(monkeypatch: Any) -> None:
    monkeypatch.setattr(whole_requests, "JOIN_SECONDS_MIN", 0.0)
    monkeypatch.setattr(whole_requests, "BYTES_PER_SECOND_MIN", 2**40)  # the wait for a turn is not a part of the limit
    now, scheduled = 1, deque[Callable[[], None]]()
    turns = LoopShares(lambda: now, lambda _, call: scheduled.append(call))
    cam, other = (Account(name, DEFAULTS, loop_shares=turns) for name in ("cam", "other"))
    assert cam.loop_share is not None
    assert other.loop_share is not None
    other.loop_share.spend(1)
    cam.loop_share.spend(10**9)
    large, reads = b"\x0a" + bytes(3 * MESSAGE_BYTES_MAX), 0
    left = iter(messages_of(large))

    async def read() -> Any:
        nonlocal reads
        reads += 1
        return next(left, EOF)

    reading = asyncio.create_task(WholeRequests(read, RequestRooms(), cam).read())
    for expected in (1, 2, 3, 4):
        for _ in range(5):
            await asyncio.sleep(0)
        assert reads == expected
        if expected < 4:
            now += 10**9
            scheduled.popleft()()
            cam.loop_share.spend(10**9)
            other.loop_share.spend(1)
    assert await reading == large


@pytest.mark.parametrize(
    ("messages", "why"),
    [
        ([piece(b"x")], "announces a request of 0 bytes"),
        ([piece(b"x", 20 * 2**20 + 1)], "announces a request of 20971521 bytes"),
        ([piece(b"x", 2)], "ended before the last piece"),
        ([piece(b"x", 2), piece(b"y", 1)], "a new first piece"),
        ([piece(b"x", 2), piece(b"")], "without content"),
        ([piece(b"x", 2), piece(b"yz")], "the pieces have 3 bytes"),
        ([piece(b"x", 2), b"\x0a\x01y"], "holds something else"),
        ([piece(b"x", 2) + b"\x10\x01"], "holds something else"),
        ([piece(b"x", 2), piece(b"y") * 2], "holds something else"),
        ([piece(b"x", 2)[:-1]], "is invalid"),
    ],
)
async def test_pieces_that_make_no_request_are_refused(messages: list[bytes], why: str) -> None:
    whole, room = stream_of(messages)
    with pytest.raises(InvalidArgument, match=why):
        await whole.read()
    assert room.used_bytes == 0


async def test_a_request_counts_as_bytes_in_flight_of_its_caller_and_more_than_its_quota_is_refused() -> None:
    account = Account("cam", {**DEFAULTS, Quota.BYTES_IN_FLIGHT: 2**20})
    fits, _ = stream_of(messages_of(bytes(2**20)), account)
    assert await fits.read() == bytes(2**20)
    whole, _ = stream_of(messages_of(bytes(2**20 + 1)), account)
    with pytest.raises(Overloaded, match="bytes-in-flight"):
        await whole.read()


async def test_a_request_whose_next_piece_does_not_arrive_is_refused_and_frees_its_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(whole_requests, "JOIN_SECONDS_MIN", 0.05)
    room, began = RequestRooms(), [piece(b"x", 100)]

    async def read() -> Any:
        if began:
            return began.pop()
        await asyncio.Event().wait()

    with pytest.raises(DeadlineExceeded, match="1 of the 100 bytes"):
        await WholeRequests(read, room, unlimited()).read()
    assert room.used_bytes == 0


async def test_a_put_and_an_enqueue_with_runs_and_a_piece_are_refused() -> None:
    async with running_host() as rig:
        channel = await rig.open()
        request = pb.PutRequest(
            channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"x")], piece=pb.RequestPiece(content=b"x")
        )
        call: Any = rig.channels.Put(iter((request,)))
        assert "runs and a piece" in await call.details()
    enqueue = queue_pb.EnqueueRequest(queue_id=bytes(16), piece=pb.RequestPiece(content=b"x"))
    with pytest.raises(InvalidArgument, match="runs and a piece"):
        whole_requests.check_without_piece(
            whole_requests.raw_run_pb2.RawEnqueueRequest.FromString(enqueue.SerializeToString())
        )
