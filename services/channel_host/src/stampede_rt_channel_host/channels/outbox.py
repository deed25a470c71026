"""The one writer of a stream on which answers come from two sides: the reader's loop, and calls that are released."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from stampede_rt_channel_host.channels.frames import EncodedMessage
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.channel import Pieces, Slice, emptying, run_to_end
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context

ANSWERS_QUEUED_MAX = 256
QUEUED_BYTES_MAX = 8 * 2**20
"""Of items that answers refer to, and one answer more."""
COUNTED_BYTES_MAX = QUEUED_BYTES_MAX // 2
"""A larger answer counts as much, so that one of them does not hold up the small ones."""


class _Answer(NamedTuple):
    """The messages of one call, made as they are written; `on_sent` hears of each one's payload bytes.

    `kept_bytes`: what the items that it refers to keep of the host's memory, even if retention has let them go.
    `emptying` lets go of those that were not sent.
    """

    call_id: int
    kept_bytes: int
    emptying: Pieces[None]
    messages: Iterator[EncodedMessage]
    on_sent: Callable[[int], None]


class Outbox:
    """Writes answers in turn, one message of each, so that a large one does not hold up the small ones.

    What is queued are references into the store, not copies. `on_end` hears of each call that was answered whole,
    `on_room` that there is room again after there was none.
    """

    def __init__(
        self,
        context: Context,
        stream: OpenStream,
        on_end: Callable[[int], None],
        on_room: Callable[[], None] = lambda: None,
        begin: Callable[[Pieces[None]], None] = run_to_end,
        account: Account | None = None,
    ) -> None:
        """`begin` does long work that nobody waits for (`PieceScheduler.begin`). What is queued is in flight for
        `account`; None: nobody's."""
        self._context = context
        self._in_flight = (account or unlimited()).hold(Quota.BYTES_IN_FLIGHT)
        self._stream = stream
        self.queued_bytes = 0
        self._on_end = on_end
        self._on_room = on_room
        self._begin = begin
        self._answers: deque[_Answer] = deque()
        self._writing = False
        self._task: asyncio.Task[None] | None = None
        self._room = asyncio.Event()

    @property
    def has_room(self) -> bool:
        """Another answer may be queued, however large it is."""
        return len(self._answers) <= ANSWERS_QUEUED_MAX and self.queued_bytes <= QUEUED_BYTES_MAX

    def add(
        self, call_id: int, messages: Iterator[EncodedMessage], on_sent: Callable[[int], None], kept_bytes: int = 0,
        slices: Sequence[Slice] = (),
    ) -> None:  # fmt: skip
        """Queue an answer, which was made of `slices`; `flush` or `kick` writes it."""
        self._answers.append(_Answer(call_id, kept_bytes, emptying(slices), messages, on_sent))
        self._count(kept_bytes)

    def drop(self, call_id: int) -> None:
        """Write no more of a call."""
        for answer in [answer for answer in self._answers if answer.call_id == call_id]:
            self._answers.remove(answer)
            self._let_go(answer)
            self._begin(answer.emptying)
        self._on_end(call_id)

    def kick(self) -> None:
        """Write in the background what is queued."""
        if self._answers and not self._writing:
            self._writing = True
            self._task = self._stream.spawn(self._write_all())

    async def flush(self) -> None:
        """After the reader's loop has queued something: write a single message right here, which costs no task; leave
        more to the background, and wait only while too much is queued, so that the caller is held back."""
        if len(self._answers) == 1 and not self._writing:
            self._writing = True
            try:
                await self._write_one()
            finally:
                self._writing = False
        self.kick()
        await self.room()

    async def room(self) -> None:
        """Wait until there is room for another answer."""
        while not self.has_room:
            self._room.clear()
            await self._room.wait()

    async def finish(self) -> None:
        """Return when everything queued is written."""
        while self._answers or self._writing:
            self.kick()
            assert self._task is not None, "the reader's loop, the other writer, is over"
            await self._task

    def close(self) -> None:
        """Write no more."""
        answers, self._answers = self._answers, deque()
        for answer in answers:
            self._begin(answer.emptying)
        if self._task is not None:
            self._task.cancel()
        self._in_flight.set(0)

    async def _write_all(self) -> None:
        try:
            while self._answers:
                await self._write_one()
        finally:
            self._writing = False

    async def _write_one(self) -> None:
        answer = self._answers.popleft()
        message = next(answer.messages)
        if not message.is_last:
            self._answers.append(answer)  # behind the others
        await self._context.write(message.encoded)
        answer.on_sent(message.payload_bytes)
        if message.is_last:
            self._let_go(answer)
            self._on_end(answer.call_id)

    def _count(self, more_bytes: int) -> None:
        self.queued_bytes += more_bytes
        self._in_flight.set(self.queued_bytes)

    def _let_go(self, answer: _Answer) -> None:
        self._count(-answer.kept_bytes)
        if self.has_room:
            self._room.set()
            self._on_room()
