"""Waits for effects of other threads and processes that no event reports."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable

WITHIN_SECONDS = 45.0
PAUSE_SECONDS = 0.02
CHECK_SECONDS = 0.005


def wait_until(holds: Callable[[], object], what: str = "", within_seconds: float = WITHIN_SECONDS) -> None:
    """Return as soon as `holds()` is true. Fails the test if it is not true in time."""
    deadline, pause = time.monotonic() + within_seconds, threading.Event()
    while not holds():
        assert time.monotonic() < deadline, f"not true after {within_seconds:g} s: {what or holds}"
        pause.wait(PAUSE_SECONDS)


async def until(holds: Callable[[], object], what: str = "", within_seconds: float = WITHIN_SECONDS) -> None:
    """Return as soon as `holds()` is true. The event loop runs meanwhile. Fails the test if it is not true in time."""
    deadline = time.monotonic() + within_seconds
    while not holds():
        assert time.monotonic() < deadline, f"not true after {within_seconds:g} s: {what or holds}"
        await pause(PAUSE_SECONDS)


async def pause(seconds: float = CHECK_SECONDS) -> None:
    """Wait between two checks of a condition. Without it the checks keep two cores busy, here and in the service."""
    await asyncio.wait({asyncio.get_running_loop().create_future()}, timeout=seconds)
