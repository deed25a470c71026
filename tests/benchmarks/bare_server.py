"""A server of bare grpcio that moves as many bytes as the product. It shows the cost that any gRPC service has."""

from __future__ import annotations

import asyncio
import struct
import sys
from collections.abc import AsyncIterator
from typing import Any

import grpc
import grpc.aio

from stampede_rt_runtime.limits import Limits

REQUEST = struct.Struct("<III")  # messages, items in each, bytes of an item
QUEUE_MESSAGES_MAX = 64
OPTIONS = (
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
    ("grpc.so_reuseport", 0),
    # The benchmark's client of this server pings each 5 s, like the client of the product. By default a gRPC server
    # allows one ping in 5 minutes on an idle connection. It ends the connection after three pings that come too early.
    ("grpc.http2.min_ping_interval_without_data_ms", Limits().ping_interval_millis_min),
)


class BareServer(grpc.GenericRpcHandler):
    """Acks the sent messages, sends the requested ones, and relays one stream to another."""

    def __init__(self) -> None:
        self._relayed: asyncio.Queue[bytes] = asyncio.Queue(QUEUE_MESSAGES_MAX)

    def service(self, details: Any) -> Any:
        method = details.method.rpartition("/")[2]
        if method == "Out":
            return grpc.unary_stream_rpc_method_handler(self._out)
        handlers = {"Ack": self._ack, "Fetch": self._fetch, "In": self._in}
        return grpc.stream_stream_rpc_method_handler(handlers[method])

    async def _ack(self, requests: AsyncIterator[bytes], context: Any) -> AsyncIterator[bytes]:
        async for _ in requests:
            yield bytes(24)

    async def _fetch(self, requests: AsyncIterator[bytes], context: Any) -> AsyncIterator[bytes]:
        async for request in requests:
            messages, items, size = REQUEST.unpack(request)
            payload = bytes(items * size)
            for _ in range(messages):
                yield payload

    async def _in(self, requests: AsyncIterator[bytes], context: Any) -> AsyncIterator[bytes]:
        async for message in requests:
            await self._relayed.put(message)
            yield bytes(24)

    async def _out(self, request: bytes, context: Any) -> AsyncIterator[bytes]:
        await context.send_initial_metadata(())
        while True:
            yield await self._relayed.get()


async def main() -> None:
    """Serve on a free port, which is printed, until standard input ends."""
    server = grpc.aio.server(options=OPTIONS)
    server.add_generic_rpc_handlers((BareServer(),))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    print(port, flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.read)
    await server.stop(None)


if __name__ == "__main__":
    asyncio.run(main())
