"""The page of metrics is made in pieces, and once for callers at the same time."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable

import pytest

from stampede_rt_runtime.listen import CannotListen
from stampede_rt_runtime.metrics import serving as metrics_serving
from stampede_rt_runtime.metrics.families import AnyFamily, gauge
from stampede_rt_runtime.metrics.serving import MetricsPage, serving_metrics
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.values import parse_address

METRICS = [gauge(f"stampede_{number}", "A.") for number in range(50)]


class Source:
    """A source of metrics that counts its calls."""

    def __init__(self) -> None:
        self.calls = 0

    async def collect(self) -> Iterable[AnyFamily]:
        self.calls += 1
        return [metric.of(self.calls) for metric in METRICS]


async def test_callers_at_the_same_time_share_one_page() -> None:
    source = Source()
    page = MetricsPage(source.collect)
    pages = await asyncio.gather(*(page.make() for _ in range(100)))
    assert source.calls == 1
    assert len(set(pages)) == 1
    assert b"stampede_49 1.0" in pages[0]
    assert await page.make() is pages[0]  # the page is fresh enough


async def test_other_tasks_run_between_two_steps_of_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metrics_serving, "STEP_SECONDS", 0.0)  # so that each family is a step
    turns = 0

    async def work() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    beside = asyncio.create_task(work())
    await MetricsPage(Source().collect).make()
    beside.cancel()
    assert turns >= len(METRICS)


async def test_a_caller_that_disconnects_does_not_end_the_page_for_other_callers() -> None:
    page = MetricsPage(Source().collect)
    leaving, staying = asyncio.create_task(page.make()), asyncio.create_task(page.make())
    await asyncio.sleep(0)
    leaving.cancel()
    assert b"stampede_0 1.0" in await staying
    await page.aclose()


async def test_a_page_shows_the_calls_the_refusals_and_the_process_of_a_server() -> None:
    server = ServiceServer(secret=None)
    async with serving_metrics(parse_address("localhost:0"), "host", server) as address:
        reader, writer = await asyncio.open_connection(*address.rsplit(":", 1))
        writer.write(b"GET /metrics HTTP/1.1\r\n\r\n")
        page = (await reader.read()).decode()
        writer.close()
    for line in (
        "stampede_ready 0.0",
        'stampede_streams_open{transport="socket"} 0.0',
        "stampede_calls_open 0.0",
        "stampede_calls_refused_total 0.0",
        "process_resident_memory_bytes",
    ):
        assert line in page
    await server.stop()


async def test_an_address_beyond_this_machine_is_reported_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    server = ServiceServer(secret=None)
    async with serving_metrics(parse_address("0.0.0.0:0"), "host", server):
        pass
    assert "metrics are served to everybody who can reach this address" in caplog.text
    await server.stop()


async def test_a_taken_port_is_reported_with_its_flag() -> None:
    server = ServiceServer(secret=None)
    async with serving_metrics(parse_address("localhost:0"), "host", server) as address:
        with pytest.raises(CannotListen, match="choose another port with --metrics"):
            async with serving_metrics(parse_address(address), "host", server):
                pass
    await server.stop()
