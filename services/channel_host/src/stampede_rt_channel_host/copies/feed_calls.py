"""The streams over which copies are fed, and their errors."""

from __future__ import annotations

import asyncio
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.fed_responses import read_response

METHOD = "/stampede_rt.v1.ReplicaService/Feed"
BROKEN_AFTER_SECONDS = 3.0  # after this silence of its source, the copy opens the feed again


def encode_request(request: pb.FeedRequest | bytes) -> bytes:
    """The bytes of a request. An answer to an item has them already."""
    return request if isinstance(request, bytes) else request.SerializeToString()


def feed_over(channel: grpc.aio.Channel) -> Any:
    """A new stream for feeds over a connection to the source."""
    return channel.stream_stream(
        METHOD,
        request_serializer=encode_request,
        response_deserializer=read_response,
    )()


def plain_error(error: BaseException, target: str) -> BaseException:
    """The product's error for a broken stream; any other error stays as it is."""
    if isinstance(error, grpc.RpcError):
        return from_rpc_error(error, target)
    if isinstance(error, StampedeError):
        return error
    if isinstance(error, DecodeError):
        return InvalidArgument(f"{target} sent bytes that are no FeedResponse; install the same release on both hosts")
    if isinstance(error, TimeoutError):
        return Unavailable(f"the source at {target} was silent for {BROKEN_AFTER_SECONDS:g} s")
    if isinstance(error, asyncio.InvalidStateError):  # grpc raises this for a write after the end of the call
        return Unavailable(f"the stream to {target} is broken")
    return error
