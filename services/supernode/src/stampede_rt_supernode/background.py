"""Runs the work that lasts as long as a supernode serves."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine
from typing import Any

from stampede_rt.errors import StampedeError
from stampede_rt_runtime.server import ServiceServer


@contextlib.asynccontextmanager
async def background(server: ServiceServer, *work: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """Run `work` while the caller's `with` block runs. If any of it ends, the service stops.

    Raises the StampedeError of the work, or an ExceptionGroup if the work has failed in another way.
    """
    tasks = [asyncio.create_task(one) for one in work]
    for task in tasks:
        task.add_done_callback(lambda _: server.stopping.set())
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        outcomes = await asyncio.gather(*tasks, return_exceptions=True)
        failures = [one for one in outcomes if isinstance(one, Exception)]
    if len(failures) == 1 and isinstance(failures[0], StampedeError):
        raise failures[0]
    if failures:
        raise ExceptionGroup("the supernode ends with a defect", failures)
