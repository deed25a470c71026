"""The limits on the moves that one drain has under way.

A move goes through several messages and two entries of the directory's log, so one move at a time leaves the hosts idle
for most of the time. A destination that does not answer can hold up only a part of these moves, so the moves to other
destinations continue.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext

PARALLEL_MOVES = 112  # a host may have 128 moves under way; callers may use the other 16
MOVES_PER_DESTINATION = 96
MOVES_AT_FIRST = 2  # the limit for a destination that has not taken over anything yet, because it may be frozen
MOVES_PER_ANSWER = 2  # the limit rises by this with each move, so that the first copies do not all begin together
SLOW_MOVE_SECONDS = 1.0  # a move that takes longer raises no limit: more moves would only share the same link
PARALLEL_QUEUE_MOVES = 6  # a host may move 8 queues at the same time; calls of a queue wait while its host copies it


class DrainRoom:
    """Limits the moves under way. The move that has waited longest for one destination begins first."""

    def __init__(self) -> None:
        self._all = asyncio.Semaphore(PARALLEL_MOVES)
        self._queues = asyncio.Semaphore(PARALLEL_QUEUE_MOVES)
        self._to: dict[bytes, asyncio.Semaphore] = {}  # by destination
        self._raised: Counter[bytes] = Counter()  # by destination: the moves by which its limit has risen

    @asynccontextmanager
    async def move_slot(self, host_id: bytes, *, is_queue: bool) -> AsyncIterator[None]:
        """Wait until the limits allow another move to that host. The move counts as under way during the block."""
        to = self._to.setdefault(host_id, asyncio.Semaphore(MOVES_AT_FIRST))
        async with self._queues if is_queue else nullcontext(), to, self._all:
            yield

    def note_move(self, host_id: bytes, seconds: float) -> None:
        """Note that this host has taken something over in this time. If it was fast, it may now have more moves."""
        if seconds > SLOW_MOVE_SECONDS:
            return
        more = min(MOVES_PER_ANSWER, MOVES_PER_DESTINATION - MOVES_AT_FIRST - self._raised[host_id])
        self._raised[host_id] += more
        for _ in range(more):
            self._to[host_id].release()
