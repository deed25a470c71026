"""What a call held goes with the call, also when it was refused: nothing is left to the garbage collector."""

from __future__ import annotations

import gc
import weakref
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving

LIST = "/stampede_rt.v1.DirectoryService/ListChannels"
WATCH = "/stampede_rt.v1.DirectoryService/Watch"


class Held:
    """Stands for what a method has in its hands when it refuses."""


class Refusing(grpc.GenericRpcHandler):
    """A single call and a stream that hold something and then raise."""

    def __init__(self) -> None:
        self.held: list[weakref.ref[Held]] = []

    def service(self, details: grpc.HandlerCallDetails) -> Any:
        if details.method == LIST:
            return grpc.unary_unary_rpc_method_handler(self._list, pb.ListChannelsRequest.FromString)
        return grpc.unary_stream_rpc_method_handler(self._watch, pb.ListChannelsRequest.FromString)

    async def _list(self, _request: pb.ListChannelsRequest, _context: Any) -> bytes:
        held = Held()
        self.held.append(weakref.ref(held))
        raise InvalidArgument("refused")

    async def _watch(self, _request: pb.ListChannelsRequest, _context: Any) -> AsyncIterator[bytes]:
        held = Held()
        self.held.append(weakref.ref(held))
        yield b""
        raise InvalidArgument("refused")


@pytest.mark.parametrize("method", [LIST, WATCH])
async def test_what_a_refused_call_held_is_freed_without_the_collector(method: str) -> None:
    handler = Refusing()
    gc.collect()
    gc.disable()
    try:
        async with serving(lambda server: server.add_generic_rpc_handlers((handler,))) as server:
            channel = dial(server.address, secret=None)
            call = channel.unary_stream(method, pb.ListChannelsRequest.SerializeToString)(pb.ListChannelsRequest())
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                async for _ in call:
                    pass
            await channel.close()
        assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
        assert [one() for one in handler.held] == [None]
    finally:
        gc.enable()
