"""The relay behind bare gRPC: `python -m stampede_rt_bench.limits.grpc_server FILE`. It writes its address to FILE."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import grpc
import grpc.aio

from stampede_rt_bench.limits.bare_grpc import LOOK_SECONDS, OPTIONS
from stampede_rt_bench.limits.framing import ACK, QUEUE_MESSAGES_MAX, REQUEST


class GrpcRelay(grpc.GenericRpcHandler):
    """Acknowledges messages of `Ack`, answers messages of `Fetch`, and passes messages of `In` on to every `Out`."""

    def __init__(self) -> None:
        self._outs: list[asyncio.Queue[bytes]] = []

    def service(self, details: Any) -> Any:
        """Return the handler of a method."""
        method = details.method.rpartition("/")[2]
        if method == "Out":
            return grpc.unary_stream_rpc_method_handler(self._keep)
        if method == "In":
            return grpc.stream_unary_rpc_method_handler(self._send_on)
        handlers = {"Ack": self._acknowledge, "Fetch": self._answer}
        return grpc.stream_stream_rpc_method_handler(handlers[method])

    async def _acknowledge(self, requests: AsyncIterator[bytes], context: Any) -> None:
        while await context.read() is not grpc.aio.EOF:
            await context.write(ACK)

    async def _answer(self, requests: AsyncIterator[bytes], context: Any) -> None:
        answers: dict[bytes, bytes] = {}
        while (request := await context.read()) is not grpc.aio.EOF:
            if request not in answers:
                items, size = REQUEST.unpack(request)
                answers = {request: bytes(items * size)}
            await context.write(answers[request])

    async def _send_on(self, requests: AsyncIterator[bytes], context: Any) -> bytes:
        while (message := await context.read()) is not grpc.aio.EOF:
            for out in self._outs:
                await out.put(message)
        return ACK

    async def _keep(self, request: bytes, context: Any) -> None:
        queue: asyncio.Queue[bytes] = asyncio.Queue(QUEUE_MESSAGES_MAX)
        self._outs.append(queue)
        try:
            await context.write(b"")
            while True:
                try:
                    async with asyncio.timeout(LOOK_SECONDS if queue.empty() else None):
                        message = await queue.get()
                except TimeoutError:
                    message = b""
                await context.write(message)
        finally:
            self._outs.remove(queue)


async def main() -> None:
    """Serve until this process is killed."""
    server = grpc.aio.server(options=OPTIONS)
    server.add_generic_rpc_handlers((GrpcRelay(),))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    path = Path(sys.argv[1])
    path.with_suffix(".new").write_text(f"127.0.0.1:{port}")
    path.with_suffix(".new").rename(path)
    await server.wait_for_termination()


if __name__ == "__main__":
    asyncio.run(main())
