"""The acks of puts that wait for replicas. The acks of a stream stay in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from stampede_rt.errors import NotReplicated
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.replication import Replication

HELD_ACKS_MAX = 1024  # the most held acks of one stream; at this number the host stops reading its requests
WAIT_NANOS_DEFAULT = 5_000_000_000  # for a put that states no wait


class AckOfReplicas:
    """An ack that is due once all items before the seq `next_seq` are replicated."""

    def __init__(
        self, ack: pb.PutAck, channel: str, replication: Replication, next_seq: int, wait_nanos: int | None
    ) -> None:
        """`wait_nanos`: the longest wait; None: without a limit."""
        self._ack = ack
        self._channel = channel
        self._replication = replication
        self._next_seq = next_seq
        self._ends_s = None if wait_nanos is None else asyncio.get_running_loop().time() + wait_nanos / 1e9

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it. After the longest wait it has the error NOT_REPLICATED."""
        replication, ack = self._replication, self._ack
        left_s = None if self._ends_s is None else max(0.0, self._ends_s - asyncio.get_running_loop().time())
        is_replicated = await replication.replicated(self._next_seq, left_s)
        ack.copies = replication.copies(self._next_seq)
        if is_replicated:
            return ack
        if replication.ended is not None:
            return refused(ack.first_number, ack.items, replication.ended, ack.host_time_unix_nano, ack.incarnation)
        items = ack.items - len(ack.rejections)
        replication.not_replicated += items
        ack.error.CopyFrom(to_error_message(self._error(items, ack.copies)))
        return ack

    def _error(self, items: int, copies: int) -> NotReplicated:
        least = self._replication.min_replicas
        return NotReplicated(
            f"channel {self._channel} has accepted the put, but the replicas did not have it in time: {copies - 1} in "
            f"sync hold it, and min_replicas is {least}; readers see it once it is replicated; look at `stampede info "
            f"{self._channel}`, or start another host",
            metadata={"channel": self._channel, "seq": str(self._ack.first_seq), "copies": str(copies)},
        )


class HeldAcks:
    """The acks of one stream that are not due, or stand behind such an ack. Passes them to `pass_on`, in order."""

    def __init__(
        self, pass_on: Callable[[pb.PutAck], Awaitable[None]],
        spawn: Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]],
    ) -> None:  # fmt: skip
        """`spawn` makes a task that ends with the stream."""
        self._pass_on = pass_on
        self._acks: deque[pb.PutAck | AckOfReplicas] = deque()
        self._changed = asyncio.Event()
        self._task = spawn(self._run())

    def __bool__(self) -> bool:
        return bool(self._acks)

    async def add(self, ack: pb.PutAck | AckOfReplicas) -> None:
        """Add an ack behind the others. Waits while there are HELD_ACKS_MAX."""
        while len(self._acks) >= HELD_ACKS_MAX:
            await self._next_change()
        self._acks.append(ack)
        self._note()

    async def all_passed(self) -> None:
        """Wait until no ack is left."""
        while self._acks:
            await self._next_change()

    def close(self) -> None:
        """Stop waiting. Idempotent."""
        self._task.cancel()

    async def _run(self) -> None:
        while True:  # until the stream ends
            while not self._acks:
                await self._next_change()
            first = self._acks[0]
            ack = first if isinstance(first, pb.PutAck) else await first.due()
            await self._pass_on(ack)
            self._acks.popleft()
            self._note()

    async def _next_change(self) -> None:
        await self._changed.wait()

    def _note(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()
