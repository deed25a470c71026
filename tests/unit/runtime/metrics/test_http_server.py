"""The page of metrics reaches Prometheus, also while other callers misbehave."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from stampede_rt_runtime.metrics import http_server
from stampede_rt_runtime.metrics.http_server import CONNECTIONS_MAX, HEAD_BYTES_MAX, MetricsHttpServer


async def page() -> bytes:
    return b"stampede_ready 1.0\n"


@pytest.fixture
async def port() -> AsyncIterator[int]:
    server = MetricsHttpServer(page, "text/plain; version=0.0.4")
    yield await server.listen("127.0.0.1", 0)
    await server.aclose()


async def ask(port: int, head: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(head)
    answer = await reader.read()
    writer.close()
    await writer.wait_closed()
    return answer


async def test_a_scrape_gets_the_page_and_its_length(port: int) -> None:
    answer = await ask(port, b"GET /metrics HTTP/1.1\r\nHost: a\r\n\r\n")
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 OK\r\nContent-Type: text/plain; version=0.0.4\r\n")
    assert b"Content-Length: %d" % len(body) in head
    assert body == await page()


async def test_a_head_request_gets_no_body(port: int) -> None:
    answer = await ask(port, b"HEAD /metrics HTTP/1.1\r\n\r\n")
    assert answer.endswith(b"\r\n\r\n")


@pytest.mark.parametrize(
    ("request_line", "status"),
    [
        (b"GET / HTTP/1.1", b"200 OK"),
        (b"GET /metrics?name=a HTTP/1.1", b"200 OK"),
        (b"GET /secret HTTP/1.1", b"404 Not Found"),
        (b"POST /metrics HTTP/1.1", b"405 Method Not Allowed"),
        (b"\xff\x00", b"405 Method Not Allowed"),
        (b"GET /" + b"a" * (2 * HEAD_BYTES_MAX), b"431 Request Header Fields Too Large"),
    ],
)
async def test_another_request_than_for_the_page_gets_an_error_status(
    port: int, request_line: bytes, status: bytes
) -> None:
    answer = await ask(port, request_line + b"\r\n\r\n")
    assert answer.startswith(b"HTTP/1.1 " + status)


async def test_silent_connections_are_closed_to_make_room_for_a_scrape(port: int) -> None:
    silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2 * CONNECTIONS_MAX)]
    answer = await ask(port, b"GET /metrics HTTP/1.1\r\n\r\n")
    assert answer.endswith(await page())
    reader, _ = silent[0]
    assert await reader.read() == b""  # the first caller made room
    for _, writer in silent:
        writer.close()


async def test_the_server_closes_the_connection_of_a_caller_that_sends_no_whole_request(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(http_server, "HEAD_SECONDS_MAX", 0.01)
    assert await ask(port, b"GET /metr") == b""
