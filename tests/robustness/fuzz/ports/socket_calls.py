"""Streams over the Unix socket of a host, whose frames are damaged now and then."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress

import grpc

import stampede_rt.v1.gatekeeper_service_pb2 as pb
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import rpc_status_pb2, socket_stream_pb2
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.wire.stream_frames import PROTOCOL_VERSION, FrameKind, frame_of
from tests.robustness.fuzz.drawing import ByteSource
from tests.support.raw_stream import raw_stream

DAMAGED_PERCENT = 30
NO_STATUS = (grpc.StatusCode.CANCELLED, "the connection ended without a status")
_CODES = {code.value[0]: code for code in grpc.StatusCode}


async def socket_target(channel: grpc.aio.Channel, metadata: tuple[tuple[str, str], ...]) -> str:
    """Ask the gatekeeper of a host for its Unix socket."""
    stub = GatekeeperServiceStub(channel)
    request = pb.ListDataEndpointsRequest(machine=this_machine())
    response = await stub.ListDataEndpoints(request, metadata=metadata)  # type: ignore[misc]
    return str(response.endpoints[0].target)


async def called_over_socket(
    target: str,
    path: str,
    requests: Sequence[bytes],
    metadata: tuple[tuple[str, str], ...],
    source: ByteSource,
    seconds: float,
) -> tuple[grpc.StatusCode, str]:
    """Return the status; CANCELLED if none comes within `seconds`, as after damage that asks for more bytes."""
    try:
        async with asyncio.timeout(seconds), raw_stream(target) as stream:
            with suppress(ConnectionError):  # the host may have ended the stream
                await stream.send_bytes(_damaged(_frames(path, requests, metadata), source))
            while (frame := await stream.frame()) is not None:
                if frame[0] == FrameKind.STATUS:
                    return _status(frame[1])
            return NO_STATUS
    except (TimeoutError, OSError):
        return grpc.StatusCode.CANCELLED, "by the caller"


def _status(body: bytes) -> tuple[grpc.StatusCode, str]:
    found = rpc_status_pb2.Status.FromString(body)
    return _CODES.get(found.code, grpc.StatusCode.UNKNOWN), found.message


def _frames(path: str, requests: Sequence[bytes], metadata: tuple[tuple[str, str], ...]) -> bytes:
    opening = socket_stream_pb2.StreamOpening(
        method=path, protocol_version=PROTOCOL_VERSION, authorization=dict(metadata).get("authorization", "")
    )
    messages = (frame_of(FrameKind.MESSAGE, request) for request in requests)
    return b"".join((frame_of(FrameKind.OPENING, opening.SerializeToString()), *messages, frame_of(FrameKind.END)))


def _damaged(frames: bytes, source: ByteSource) -> bytes:
    """Cut, change, repeat or extend the bytes in some streams."""
    if not source.chance(DAMAGED_PERCENT):
        return frames
    at = source.below(len(frames))
    kind = source.below(4)
    if kind == 0:
        return frames[:at]
    if kind == 1:
        return frames[:at] + bytes((source.below(256),)) + frames[at + 1 :]
    if kind == 2:
        return frames[:at] + frames[at // 2 :]
    return frames[:at] + source.take(20) + frames[at:]
