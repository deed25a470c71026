"""Reads on in a stream of puts while one put waits, so that each put's waiting time counts from the put's arrival."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from grpc.aio import EOF

from stampede_rt_channel_host.channels.limits.memory import Charge, MemoryBudget
from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.limits import Quota

AHEAD_REQUESTS_MAX = 1024
AHEAD_BYTES_MAX = 4 * 2**20  # the last request may exceed this limit


class RequestSource(Protocol):
    """The source of the whole requests of a stream, such as `WholeRequests`."""

    async def read(self) -> Any:
        """The next request, or EOF."""

    def release(self) -> None:
        """Stop counting the bytes of the last request. Idempotent."""


class ReadAhead:
    """Gives the requests of a stream in order. Reads further requests ahead while the last given one has to wait.

    The requests read ahead count as memory of the host and as bytes in flight of the caller. A request counts until
    `release`, or until the next call of `next`. At the bounds, or when the host's memory or the caller's quota is used
    up, the host stops reading ahead. Flow control then slows the caller down.
    """

    def __init__(self, requests: RequestSource, memory: MemoryBudget, account: Account) -> None:
        self._requests = requests
        self._memory = memory
        self._charge = Charge(memory)
        self._account = account
        self._in_flight = account.charge_for(Quota.BYTES_IN_FLIGHT)
        self._received: deque[tuple[Any, float]] = deque()  # the requests read ahead, each with its monotonic time
        self._bytes = 0  # the bytes of `_received`, of the request that `next` gave last, and of `keeping`
        self._given_bytes = 0  # the bytes of the request that `next` gave last, if it was read ahead
        self._task: asyncio.Task[None] | None = None
        self._failure: Exception | None = None
        self._wanted = False  # whether `next` has been called since `start`: the task then begins no further read
        self._wakeup = asyncio.Event()

    async def next(self) -> tuple[Any, float]:
        """The next request or EOF, and the monotonic time at which it came. Raises the errors of reading.

        The bytes of the request count until `release`, so that the request may wait for the turn of its caller.
        """
        self.release()
        self._wanted = True  # a begun read cannot be cancelled: wait for it, and begin no other
        while not self._received and self._task is not None:
            self._wakeup.clear()
            await self._wakeup.wait()
        if not self._received:
            if self._failure is not None:
                raise self._failure
            return await self._requests.read(), time.monotonic()
        raw, received_s = self._received.popleft()
        self._given_bytes = 0 if raw is EOF else len(raw)
        return raw, received_s

    @property
    def is_ahead(self) -> bool:
        """Whether the stream reads ahead, or requests that it has read ahead are left."""
        return self._task is not None or bool(self._received)

    def release(self) -> None:
        """Stop counting the request that `next` gave last, because its runs are judged now. Idempotent."""
        self._requests.release()
        self._count(-self._given_bytes)
        self._given_bytes = 0

    @contextmanager
    def keeping(self, kept_bytes: int) -> Iterator[None]:
        """Read on as `start`. During the block also count `kept_bytes`: the other runs of the request that waits."""
        self._count(kept_bytes)
        self.start()
        try:
            yield
        finally:
            self._count(-kept_bytes)

    def start(self) -> None:
        """Read on until the next call of `next`, because the last request has to wait."""
        self._wanted = False
        if self._task is None and self._failure is None and not (self._received and self._received[-1][0] is EOF):
            self._task = asyncio.create_task(self._read_on())

    async def _read_on(self) -> None:
        try:
            while not self._wanted and self._has_room:
                raw = await self._requests.read()
                self._received.append((raw, time.monotonic()))
                if raw is EOF:
                    break
                self._count(len(raw))
                self._requests.release()
                del raw  # so that the request is not kept in memory while the next one is read
        except Exception as error:  # noqa: BLE001  # `next` raises it
            self._failure = error
        finally:
            self._task = None
            self._wakeup.set()

    @property
    def _has_room(self) -> bool:
        return (
            len(self._received) < AHEAD_REQUESTS_MAX
            and self._bytes < AHEAD_BYTES_MAX
            and self._memory.used_bytes < self._memory.bytes_max
            and self._account.has_room(Quota.BYTES_IN_FLIGHT)
        )

    def _count(self, more_bytes: int) -> None:
        self._bytes += more_bytes
        self._charge.set(self._bytes)
        self._in_flight.set(self._bytes)

    def close(self) -> None:
        """Stop reading, and forget the requests that were read ahead."""
        self._received.clear()
        self._failure = None  # the error refers to the frame of the task, and so to this object
        self.release()
        self._count(-self._bytes)
        if self._task is not None:
            self._task.cancel()


def left_nanos(wait_nanos: int, received_s: float) -> int:
    """The part of `wait_nanos` that a put has left, in nanoseconds. `received_s`: when its request came, monotonic."""
    return max(0, wait_nanos - round((time.monotonic() - received_s) * 1e9))
