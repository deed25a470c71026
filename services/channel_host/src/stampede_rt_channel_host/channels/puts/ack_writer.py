"""Writes the acks of a stream of puts in order, also acks that wait for replicas or for stable storage."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.held_acks import HELD_ACKS_MAX, HeldAck, HeldAcks, Spawn
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.rpc import Context, StartedCoroutine

# The most acks that wait for the writer, and so the most acks in one message. Even if each ack has 256 refused items,
# the message stays below its size limit.
ACKS_QUEUED_MAX = 256
RUNS_PER_TURN = 4
"""A stream judges this number of runs of a request in one turn of the event loop. A run of 256 items whose times lie
between the times of held items takes 1.5 ms.
"""


class AckWriter:
    """Writes the acks of one stream. Acks that become due during a write go out in the next message.

    The write of an ack that has waited begins in the turn of the event loop in which the ack becomes due.
    """

    def __init__(self, context: Context, encode: Callable[[list[pb.PutAck]], bytes], spawn: Spawn) -> None:
        """`encode` makes a message of `context`. `spawn` makes a task that ends with the stream."""
        self._context = context
        self._encode = encode
        self._work = current_work()
        self._acks: list[pb.PutAck] = []
        self._held = HeldAcks(self._on_due, spawn)
        self._is_writing = self._is_closed = False
        self._started_write: StartedCoroutine | None = None  # a write that has not ended; the task awaits it
        self._wakeup = asyncio.Event()  # there are acks to write, or no more acks come
        self._room = asyncio.Event()  # a write has taken the acks
        self._task: asyncio.Task[None] | None = spawn(self._run())

    @property
    def is_idle(self) -> bool:
        """Whether no ack waits, and none is being written."""
        return not (self._acks or self._is_writing or self._held)

    async def add(self, ack: pb.PutAck | HeldAck) -> None:
        """Add an ack after all others. Waits for room. Then call `write` or `wake`."""
        while len(self._acks) >= ACKS_QUEUED_MAX or len(self._held) >= HELD_ACKS_MAX:
            self.wake()
            self._room.clear()
            await self._room.wait()
        if isinstance(ack, pb.PutAck) and not self._held:
            self._acks.append(ack)
        else:
            self._held.add(ack)

    def hold(self, acks: Iterable[pb.PutAck | HeldAck]) -> None:
        """Write the acks of one request as soon as they are due. The writer must be idle."""
        for ack in acks:
            self._held.add(ack)
        self.wake()

    async def write(self) -> None:
        """Write all acks that are due. If another write is under way, these acks go out after it."""
        if self._is_writing or not self._has_due:
            return
        self._is_writing = True
        try:
            await self._context.write(self._encode(self._take()))
        finally:
            self._is_writing = False
        self.wake()

    def wake(self) -> None:
        """Let a task of this writer write the acks that are due."""
        if self._has_due:
            self._wakeup.set()

    async def finish(self) -> None:
        """Write all acks that were added, as soon as they are due."""
        self._is_closed = True
        self._wakeup.set()
        assert self._task is not None, "a closed writer has nothing to write"
        await self._task

    def close(self) -> None:
        """Write nothing more, and drop everything that refers back to this object. Idempotent."""
        if self._task is not None:
            self._task.cancel()
        if self._started_write is not None:
            self._started_write.close()
        self._held.close()
        self._task = None

    @property
    def _has_due(self) -> bool:
        return bool(self._acks) or self._held.is_due

    def _take(self) -> list[pb.PutAck]:
        """The acks of the next message."""
        acks, self._acks = self._acks, []
        acks += self._held.take(ACKS_QUEUED_MAX - len(acks))
        self._room.set()
        return acks

    def _on_due(self, in_this_turn: bool) -> None:
        """Write the acks that have become due. If `in_this_turn` is False, the task writes them. The task also awaits
        unfinished writes.
        """
        if in_this_turn and not self._is_writing:
            self._work.spend_write()
            write = StartedCoroutine(self._context.write(self._encode(self._take())))
            if write.is_done:
                self.wake()
            else:
                self._started_write, self._is_writing = write, True
        if not in_this_turn or self._started_write is not None or self._is_closed:
            self._wakeup.set()

    async def _run(self) -> None:
        while not (self._is_closed and not self._acks and not self._held and self._started_write is None):
            if (write := self._started_write) is not None:
                self._started_write = None
                try:
                    await write
                finally:
                    self._is_writing = False
            elif self._is_writing or not self._has_due:
                self._wakeup.clear()
                await self._wakeup.wait()
            else:
                await self.write()
