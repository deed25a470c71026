"""Serves the metrics of a service for as long as it runs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable

from stampede_rt_runtime.listen import CannotListen, check_listen, is_loopback_address
from stampede_rt_runtime.metrics.families import AnyFamily
from stampede_rt_runtime.metrics.http_server import MetricsHttpServer
from stampede_rt_runtime.metrics.loop_lag import LoopLag
from stampede_rt_runtime.metrics.service_metrics import of_server
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.values import Address

logger = logging.getLogger(__name__)

REUSE_SECONDS_MIN, REUSE_SECONDS_MAX = 1.0, 10.0
REUSE_FACTOR = 20
"""The service gives callers the same page for REUSE_FACTOR times the time that it took to make the page. So scrapes
take at most 5 % of a core. REUSE_SECONDS_MAX limits the reuse of a page that took more than half a second, and scrapes
may then take more.
"""

STEP_SECONDS = 0.001
"""The time that one step spends on the page before other work runs. If each family had a step of its own, the page
would take long on a busy event loop."""

Collect = Callable[[], Awaitable[Iterable[AnyFamily]]]


class MetricsPage:
    """Makes the page of metrics in pieces, once for all callers that ask for it at about the same time."""

    def __init__(self, *sources: Collect) -> None:
        self._sources = sources
        self._making: asyncio.Task[bytes] | None = None
        self._page = b""
        self._fresh_until_s = 0.0

    async def make(self) -> bytes:
        """The page. It may be a few seconds old (REUSE_SECONDS_MAX)."""
        if self._making is None or self._making.done():
            if asyncio.get_running_loop().time() < self._fresh_until_s:
                return self._page
            self._making = asyncio.create_task(self._make(), name="metrics")
        return await asyncio.shield(self._making)

    async def aclose(self) -> None:
        """Stop making the page."""
        if self._making is not None:
            self._making.cancel()
            await asyncio.gather(self._making, return_exceptions=True)

    async def _make(self) -> bytes:
        # not at the top: a service without metrics does not load the library
        from prometheus_client import ProcessCollector

        from stampede_rt_runtime.metrics.exposition import printed, printed_metric

        loop = asyncio.get_running_loop()
        began_s, step_began_s = loop.time(), time.perf_counter()
        parts: list[bytes] = []
        for collect in self._sources:
            for family in await collect():
                parts.append(printed(family))
                if time.perf_counter() - step_began_s >= STEP_SECONDS:
                    await asyncio.sleep(0)
                    step_began_s = time.perf_counter()
        parts += map(printed_metric, ProcessCollector(registry=None).collect())
        self._page, now_s = b"".join(parts), loop.time()
        reuse_s = min(max(REUSE_FACTOR * (now_s - began_s), REUSE_SECONDS_MIN), REUSE_SECONDS_MAX)
        self._fresh_until_s = now_s + reuse_s
        return self._page


@contextlib.asynccontextmanager
async def serving_metrics(
    listen: Address | None, service: str, server: ServiceServer, *sources: Collect
) -> AsyncIterator[str]:
    """Serve the metrics of `server` and of `sources` inside the block. `listen` None: serve none.

    Gives the address; empty if there is none. Raises CannotListen.
    """
    if listen is None:
        yield ""
        return
    from stampede_rt_runtime.metrics.exposition import CONTENT_TYPE

    lag = LoopLag()

    async def server_metrics() -> Iterable[AnyFamily]:
        return of_server(server, service, lag)

    page = MetricsPage(server_metrics, *sources)
    http = MetricsHttpServer(page.make, CONTENT_TYPE)
    address = await _listen(http, listen)
    measuring = asyncio.create_task(lag.measure(), name="event loop lag")
    try:
        yield address
    finally:
        measuring.cancel()
        await http.aclose()
        await page.aclose()


async def _listen(http: MetricsHttpServer, listen: Address) -> str:
    checked = check_listen(str(listen), allow_insecure_anywhere=True, flag="--metrics")
    try:
        port = await http.listen(checked.host, checked.port)
    except OSError as error:
        raise CannotListen(f"{checked} cannot be used to serve metrics: {error.strerror}") from error
    address = str(Address(checked.host, port))
    if is_loopback_address(checked):
        logger.info("metrics are served", extra={"event": "metrics_served", "address": address})
    else:
        logger.warning(
            "metrics are served to everybody who can reach this address, without a credential and without encryption; "
            "they show counts, and the names of channels, queues, groups and callers, but no payloads",
            extra={"event": "metrics_exposed", "address": address},
        )
    return address
