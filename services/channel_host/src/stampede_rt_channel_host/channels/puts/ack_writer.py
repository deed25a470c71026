"""Writes the acks of a stream of puts, also those that wait for replicas or for stable storage, in order."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from typing import Any

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.held_acks import HeldAck, HeldAcks, to_nobody

# The most acks that wait for the writer, and so the most acks in one message. Even if each ack has 256 refused items,
# the message stays below its size limit.
ACKS_QUEUED_MAX = 256
Spawn = Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]]


class AckWriter:
    """Writes the acks of one stream. Acks that come during a write go out in the next message."""

    def __init__(self, write: Callable[[list[pb.PutAck]], Awaitable[None]], spawn: Spawn) -> None:
        """`write` writes one message. `spawn` makes a task that ends with the stream."""
        self._write_message = write
        self._spawn = spawn
        self._acks: list[pb.PutAck] = []
        self._held: HeldAcks | None = None  # made when the first ack must wait
        self._is_writing = self._is_closed = False
        self._news = asyncio.Event()  # there are acks to write, or no more acks come
        self._room = asyncio.Event()  # a write has taken the acks
        self._task: asyncio.Task[None] | None = spawn(self._run())

    @property
    def is_idle(self) -> bool:
        """Whether no ack waits, and none is being written."""
        return not (self._acks or self._is_writing or self._held)

    async def add(self, ack: pb.PutAck | HeldAck) -> None:
        """Add an ack after all others. Waits for room. Then call `write` or `wake`."""
        if isinstance(ack, pb.PutAck) and not self._held:
            await self._queue(ack)
        else:
            await self._holding().room()
            self._holding().add(ack)

    def hold(self, acks: Iterable[pb.PutAck | HeldAck]) -> None:
        """Write the acks of one request as soon as they are due. The writer must be idle."""
        for ack in acks:
            self._holding().add(ack)

    async def write(self) -> None:
        """Write all acks that are due. If another write is under way, they follow it."""
        if self._is_writing or not self._acks:
            return
        acks, self._acks = self._acks, []
        self._room.set()
        self._is_writing = True
        try:
            await self._write_message(acks)
        finally:
            self._is_writing = False
        self.wake()

    def wake(self) -> None:
        """Let a task of this writer write the acks that are due."""
        if self._acks:
            self._news.set()

    async def finish(self) -> None:
        """Write all acks that were added, as soon as they are due."""
        if self._held is not None:
            await self._held.all_passed()
        self._is_closed = True
        self._news.set()
        assert self._task is not None, "a closed writer has nothing to write"
        await self._task

    def close(self) -> None:
        """Write nothing more, and drop everything that refers back to this object. Idempotent."""
        if self._task is not None:
            self._task.cancel()
        if self._held is not None:
            self._held.close()
        self._task, self._write_message = None, to_nobody

    def _holding(self) -> HeldAcks:
        if self._held is None:
            self._held = HeldAcks(self._pass_on, self._spawn)
        return self._held

    async def _pass_on(self, acks: list[pb.PutAck]) -> None:
        for ack in acks:
            await self._queue(ack)
        await self.write()

    async def _queue(self, ack: pb.PutAck) -> None:
        while len(self._acks) >= ACKS_QUEUED_MAX:
            self.wake()
            self._room.clear()
            await self._room.wait()
        self._acks.append(ack)  # after the await, during which a write may replace the list

    async def _run(self) -> None:
        while not (self._is_closed and not self._acks):
            if not self._acks or self._is_writing:
                self._news.clear()
                await self._news.wait()
            else:
                await self.write()
