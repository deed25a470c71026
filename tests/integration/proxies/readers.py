"""Readers and a producer for tests, each in its own thread, and a check that all readers got every item.

The tests of this folder connect over gRPC. On one machine readers would otherwise follow the owner's shared memory, and
use no proxy.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from tests.support.waiting import wait_until

PUT_PAUSE_S = 0.002


class BackgroundReader:
    """One subscription, and the seqs that it got."""

    def __init__(self, subscription: Any) -> None:
        self.subscription = subscription
        self.seqs: list[int] = []
        self.error: st.StampedeError | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            for item in self.subscription:
                self.seqs.append(item.seq)
        except st.StampedeError as error:
            self.error = error

    @property
    def last(self) -> int:
        return self.seqs[-1] if self.seqs else 0

    def close(self) -> None:
        self.subscription.close()
        self._thread.join(20)


class BackgroundProducer:
    """Puts small items, one after the other, until it is stopped."""

    def __init__(self, channel: Any) -> None:
        self._channel = channel
        self._stop = threading.Event()
        self.last = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(PUT_PAUSE_S):
            self.last = self._channel.put(b"an item").seq

    def stop(self) -> int:
        """End the puts. Returns the seq of the last item."""
        self._stop.set()
        self._thread.join(20)
        return self.last


@contextmanager
def reading(channel: Any, count: int, start: Any = st.OLDEST, **options: Any) -> Iterator[list[BackgroundReader]]:
    """Begin `count` subscriptions of a channel."""
    readers = [BackgroundReader(channel.subscribe(start, **options)) for _ in range(count)]
    try:
        yield readers
    finally:
        for reader in readers:
            reader.close()


class AwaitedReading:
    """Like `BackgroundReader`, with the asyncio client, on an event loop in a thread of its own."""

    def __init__(self, address: str, channel: str, transport: Any) -> None:
        self.subscription: Any = None
        self.seqs: list[int] = []
        self.error: st.StampedeError | None = None
        self._begun = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run(address, channel, transport)), daemon=True)
        self._thread.start()
        assert self._begun.wait(20), "the reader has begun"

    async def _run(self, address: str, channel: str, transport: Any) -> None:
        self._loop = asyncio.get_running_loop()
        async with aio.connect(address, transport=transport) as rt:
            self.subscription = (await rt.channel(channel)).subscribe(st.OLDEST)
            self._begun.set()
            try:
                async for item in self.subscription:
                    self.seqs.append(item.seq)
            except st.StampedeError as error:
                self.error = error

    @property
    def last(self) -> int:
        return self.seqs[-1] if self.seqs else 0

    def close(self) -> None:
        self._loop.call_soon_threadsafe(self.subscription.close)
        self._thread.join(20)


@contextmanager
def awaited_reading(address: str, channel: str, transport: Any) -> Iterator[AwaitedReading]:
    """Begin a subscription of the asyncio client."""
    reader = AwaitedReading(address, channel, transport)
    try:
        yield reader
    finally:
        reader.close()


@contextmanager
def produced(channel: Any) -> Iterator[BackgroundProducer]:
    """A producer that is stopped at the end, whatever happens."""
    producing = BackgroundProducer(channel)
    try:
        yield producing
    finally:
        producing.stop()


def all_saw(readers: list[BackgroundReader], last: int) -> None:
    """Check that every reader got each item up to `last` once and in order."""
    wait_until(
        lambda: all(reader.last >= last or reader.error for reader in readers), f"all readers have seen seq {last}"
    )
    for reader in readers:
        assert reader.error is None, reader.error
        assert reader.seqs == [*range(1, last + 1)]


def wait_for_puts(producing: BackgroundProducer, items: int) -> None:
    """Wait until the producer has put this many further items."""
    goal = producing.last + items
    wait_until(lambda: producing.last >= goal, f"{items} further items")


def eventually(holds: Callable[[], Any], what: str) -> None:
    """`wait_until`, for conditions that ask the cluster, which may not answer for a moment."""

    def holds_now() -> bool:
        try:
            return bool(holds())
        except st.StampedeError:
            return False

    wait_until(holds_now, what)
