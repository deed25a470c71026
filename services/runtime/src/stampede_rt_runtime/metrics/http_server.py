"""The HTTP server of the metrics. It runs on the event loop that serves, and answers `GET /metrics` only.

`http.server` and the server of prometheus-client take a thread for each connection, and limit neither the number of
threads nor their time. This server has both bounds. It makes an answer in pieces, so that the event loop does other
work in between.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Awaitable, Callable

CONNECTIONS_MAX = 16
HEAD_BYTES_MAX = 8192
HEAD_SECONDS_MAX = 5.0
"""The time in seconds in which a caller must send its request."""
ANSWER_SECONDS_MAX = 15.0
"""The time in seconds that the answer may take. Prometheus waits for 10 s by default."""
PATH = "/metrics"

_USAGE = b"This is a service of Stampede RT. Its metrics are at /metrics.\n"


class MetricsHttpServer:
    """Serves the page that `make_page` makes, to all callers that can connect.

    If CONNECTIONS_MAX connections are open, a further one takes the place of the oldest one.
    """

    def __init__(self, make_page: Callable[[], Awaitable[bytes]], content_type: str) -> None:
        self._make_page = make_page
        self._content_type = content_type.encode()
        self._server: asyncio.Server | None = None
        self._open: dict[asyncio.Task[None], None] = {}

    async def listen(self, host: str, port: int) -> int:
        """Listen at an address. Returns the port. Raises OSError."""
        if not port:  # with port 0, each address of a host name would get a port of its own
            host = str(socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)[-1][4][0])
        self._server = await asyncio.start_server(self._accept, host, port, limit=HEAD_BYTES_MAX)
        return int(self._server.sockets[0].getsockname()[1])

    async def aclose(self) -> None:
        """Stop listening, and end all connections."""
        if self._server is not None:
            self._server.close()
        ending = [*self._open]
        for one in ending:
            one.cancel()
        await asyncio.gather(*ending, return_exceptions=True)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None, "callbacks of connections run in tasks"
        if len(self._open) >= CONNECTIONS_MAX:
            oldest = next(iter(self._open))
            del self._open[oldest]
            oldest.cancel()
        self._open[task] = None
        try:
            with contextlib.suppress(OSError, TimeoutError, asyncio.CancelledError):
                await self._serve(reader, writer)
        finally:
            self._open.pop(task, None)
            writer.transport.abort() if task.cancelling() else writer.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(HEAD_SECONDS_MAX):
                head = await reader.readuntil(b"\r\n\r\n")
        except asyncio.LimitOverrunError:
            answer = _answer(b"431 Request Header Fields Too Large", b"the request is too long\n")
        except asyncio.IncompleteReadError:
            return
        else:
            async with asyncio.timeout(ANSWER_SECONDS_MAX):
                answer = await self._answer_to(head)
        async with asyncio.timeout(ANSWER_SECONDS_MAX):
            writer.write(answer)
            await writer.drain()

    async def _answer_to(self, head: bytes) -> bytes:
        method, _, rest = head.partition(b"\r\n")[0].partition(b" ")
        path = rest.partition(b" ")[0].partition(b"?")[0]
        if method not in (b"GET", b"HEAD"):
            return _answer(b"405 Method Not Allowed", _USAGE, b"Allow: GET, HEAD\r\n")
        if path == b"/":
            return _answer(b"200 OK", _USAGE, is_head=method == b"HEAD")
        if path != PATH.encode():
            return _answer(b"404 Not Found", _USAGE, is_head=method == b"HEAD")
        page = await self._make_page()
        return _answer(b"200 OK", page, content_type=self._content_type, is_head=method == b"HEAD")


def _answer(
    status: bytes,
    body: bytes,
    fields: bytes = b"",
    *,
    content_type: bytes = b"text/plain; charset=utf-8",
    is_head: bool = False,
) -> bytes:
    """An HTTP answer after which the connection ends."""
    head = (
        b"HTTP/1.1 %b\r\nContent-Type: %b\r\nContent-Length: %d\r\nX-Content-Type-Options: nosniff\r\n"
        b"Cache-Control: no-store\r\nConnection: close\r\n%b\r\n" % (status, content_type, len(body), fields)
    )
    return head if is_head else head + body
