"""Streams over the Unix socket and the TCP port of a host, whose frames are damaged now and then."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Sequence
from contextlib import AsyncExitStack, suppress
from typing import NamedTuple

import grpc

import stampede_rt.v1.gatekeeper_service_pb2 as pb
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import rpc_status_pb2, socket_stream_pb2
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.wire.stream_frames import PROTOCOL_VERSION, FrameKind, frame_of
from tests.robustness.fuzz.drawing import ByteSource
from tests.support.raw_stream import RawStream, raw_stream

DAMAGED_PERCENT = 30
NO_TLS_PERCENT = 10  # the share of streams without TLS to a port with TLS
CONNECT_SECONDS = 20.0  # a host takes 300 handshakes a second at most, and hundreds may wait
NO_STATUS = (grpc.StatusCode.CANCELLED, "the connection ended without a status")
_CODES = {code.value[0]: code for code in grpc.StatusCode}


class SocketPort(NamedTuple):
    """A socket of a host, "unix:PATH" or "tcp:HOST:PORT", and the TLS of its connections."""

    target: str
    tls: ssl.SSLContext | None = None
    percent: int = 100
    """The share of the streams that use this socket. The others use gRPC."""


async def socket_targets(channel: grpc.aio.Channel, metadata: tuple[tuple[str, str], ...]) -> list[str]:
    """Ask the gatekeeper of a host for the host's sockets: "unix:PATH", then "tcp:PORT"."""
    stub = GatekeeperServiceStub(channel)
    request = pb.ListDataEndpointsRequest(machine=this_machine())
    response = await stub.ListDataEndpoints(request, metadata=metadata)  # type: ignore[misc]
    return list(dict.fromkeys(one.target for one in response.endpoints))


async def socket_target(channel: grpc.aio.Channel, metadata: tuple[tuple[str, str], ...]) -> str:
    """Ask the gatekeeper of a host for the host's first socket: the Unix socket, if the caller can use it."""
    return (await socket_targets(channel, metadata))[0]


async def called_over_socket(
    port: SocketPort,
    path: str,
    requests: Sequence[bytes],
    metadata: tuple[tuple[str, str], ...],
    source: ByteSource,
    seconds: float,
) -> tuple[grpc.StatusCode, str]:
    """Send the requests over a new stream, perhaps with damage, and return the status.

    CANCELLED: the connection failed, or ended without a status, or no status came within `seconds`. If the damage has
    changed a length, the host may wait for more bytes.
    """
    frames = _damaged(_frames(path, requests, metadata), source)
    if port.tls is not None and source.chance(NO_TLS_PERCENT):
        return await _sent_without_tls(port.target, frames, seconds)
    try:
        async with AsyncExitStack() as stack:
            async with asyncio.timeout(CONNECT_SECONDS):
                stream = await stack.enter_async_context(raw_stream(port.target, port.tls))
            async with asyncio.timeout(seconds):
                with suppress(ConnectionError):  # the host may have ended the stream
                    await stream.send_bytes(frames)
                return await _status_of(stream)
    except (TimeoutError, OSError):
        return grpc.StatusCode.CANCELLED, "by the caller"


async def _status_of(stream: RawStream) -> tuple[grpc.StatusCode, str]:
    while (frame := await stream.frame()) is not None:
        if frame[0] == FrameKind.STATUS:
            return _status(frame[1])
    return NO_STATUS


async def _sent_without_tls(target: str, data: bytes, seconds: float) -> tuple[grpc.StatusCode, str]:
    """Send bytes without a handshake to a port that expects TLS. Returns CANCELLED."""
    host, _, port = target.removeprefix("tcp:").rpartition(":")
    with suppress(TimeoutError, OSError):
        async with asyncio.timeout(CONNECT_SECONDS):
            reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(data)
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await reader.read()
        writer.transport.abort()
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
    """In some streams, cut off the end, change a byte, repeat bytes, or insert bytes."""
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
