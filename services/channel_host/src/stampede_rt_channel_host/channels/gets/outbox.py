"""The queue of the answers of one stream of gets, and the only writer of this stream."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from stampede_rt_channel_host.channels.frames import EncodedMessage
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.channel import Pieces, Slice, emptying, run_to_end
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.quotas.accounts import Account, unlimited
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context

ANSWERS_QUEUED_MAX = 256
QUEUED_BYTES_MAX = 8 * 2**20
"""The most bytes of stored items that the queued answers keep in memory. One more answer may exceed the limit."""
COUNTED_BYTES_MAX = QUEUED_BYTES_MAX // 2
"""A larger answer counts as this many bytes, so that one such answer does not block small ones."""


class _Answer(NamedTuple):
    """The messages of one call. Each message is made when it is written.

    `on_sent` gets the numbers of items and of payload bytes of each written message. `kept_bytes`: the bytes of stored
    items that the answer keeps in memory, even after retention has collected these items. `emptying` frees the items
    that were not sent.
    """

    call_id: int
    kept_bytes: int
    emptying: Pieces[None]
    messages: Iterator[EncodedMessage]
    on_sent: Callable[[int, int], None]


class Outbox:
    """Writes one message of each answer in turn, so that a large answer does not block small ones.

    The queue holds references to stored runs, not copies. The outbox calls `on_end` when it has written or
    dropped the whole answer of a call. It calls `on_room` after each such answer, if there is room for another one.
    """

    def __init__(
        self,
        context: Context,
        stream: OpenStream,
        on_end: Callable[[int], object],
        on_room: Callable[[], object] = lambda: None,
        begin: Callable[[Pieces[None]], None] = run_to_end,
        account: Account | None = None,
    ) -> None:
        """`begin` does long work for which no caller waits (`PieceScheduler.begin`).

        The queued bytes count as in flight for `account`; None: for no caller.
        """
        self._context = context
        self._in_flight = (account or unlimited()).charge_for(Quota.BYTES_IN_FLIGHT)
        self._work = current_work()
        self._stream = stream
        self.queued_bytes = 0
        self._on_end = on_end
        self._on_room = on_room
        self._begin = begin
        self._answers: deque[_Answer] = deque()
        self._writing = self._is_closed = False
        self._task: asyncio.Task[None] | None = None
        self._room = asyncio.Event()

    @property
    def has_room(self) -> bool:
        """Whether the outbox may take another answer, however large."""
        return len(self._answers) <= ANSWERS_QUEUED_MAX and self.queued_bytes <= QUEUED_BYTES_MAX

    def add(
        self, call_id: int, messages: Iterator[EncodedMessage], on_sent: Callable[[int, int], None],
        kept_bytes: int = 0, slices: Sequence[Slice] = (),
    ) -> None:  # fmt: skip
        """Queue an answer that was made of `slices`. `flush` or `kick` writes it.

        After `close` the outbox only frees the answer.
        """
        if self._is_closed:
            self._begin(emptying(slices))
            return
        self._answers.append(_Answer(call_id, kept_bytes, emptying(slices), messages, on_sent))
        self._count(kept_bytes)

    def drop(self, call_id: int) -> None:
        """Write no further message of a call, and report the end of the call with `on_end`."""
        for answer in [answer for answer in self._answers if answer.call_id == call_id]:
            self._answers.remove(answer)
            self._release_bytes(answer)
            self._begin(answer.emptying)
        self._on_end(call_id)

    def kick(self) -> None:
        """Let a task write the queued answers."""
        if self._answers and not self._writing:
            self._writing = True
            self._task = self._stream.spawn(self._write_all())

    async def flush(self) -> None:
        """Write the queued answers. The loop that reads the requests calls this after each request.

        If one answer is queued and no task is writing, this call writes the next message of that answer itself. It
        leaves all other messages to a task. While the queue is full, this call waits, which slows the caller down.
        """
        if len(self._answers) == 1 and not self._writing:
            self._writing = True
            try:
                await self._write_one()
            finally:
                self._writing = False
        self.kick()
        await self.room()

    def flush_now(self, write: Callable[[bytes], None]) -> None:
        """Like `flush`, but never wait for room, and use `write` for the message that `flush` would write itself."""
        if len(self._answers) == 1 and not self._writing:
            answer = self._answers.popleft()
            message = next(answer.messages)
            if not message.is_last:
                self._answers.append(answer)
            write(message.encoded)
            self._note_sent(answer, message)
        self.kick()

    @property
    def is_empty(self) -> bool:
        """Whether no answer is queued or being written."""
        return not (self._answers or self._writing)

    async def room(self) -> None:
        """Wait until there is room for another answer."""
        while not self.has_room:
            self._room.clear()
            await self._room.wait()

    async def finish(self) -> None:
        """Return when every queued message is written."""
        while self._answers or self._writing:
            self.kick()
            assert self._task is not None, (
                "a task writes; `flush` writes only in the loop that reads the requests, and this loop has ended"
            )
            await self._task

    def close(self) -> None:
        """Write no further messages, and free the queued answers."""
        self._is_closed = True
        answers, self._answers = self._answers, deque()
        for answer in answers:
            self._begin(answer.emptying)
        if self._task is not None:
            self._task.cancel()
        # These functions refer to the owner of this object.
        self._task, self._on_end, self._on_room = None, _ignore, _ignore
        self._in_flight.set(0)

    async def _write_all(self) -> None:
        try:
            while self._answers:
                if self._work.must_wait:
                    await self._work.turn()
                if self._answers:  # a cancellation may have dropped them meanwhile
                    await self._write_one()
        finally:
            self._writing = False

    async def _write_one(self) -> None:
        answer = self._answers.popleft()
        self._work.spend_write()
        message = next(answer.messages)
        if not message.is_last:
            self._answers.append(answer)  # after the other answers
        await self._context.write(message.encoded)
        self._note_sent(answer, message)

    def _note_sent(self, answer: _Answer, message: EncodedMessage) -> None:
        answer.on_sent(message.items, message.payload_bytes)
        if message.is_last:
            self._release_bytes(answer)
            self._on_end(answer.call_id)

    def _count(self, more_bytes: int) -> None:
        self.queued_bytes += more_bytes
        self._in_flight.set(self.queued_bytes)

    def _release_bytes(self, answer: _Answer) -> None:
        """Stop counting the bytes of an answer. If there is room now, end the waits in `room`, and call `on_room`."""
        self._count(-answer.kept_bytes)
        if self.has_room:
            self._room.set()
            self._on_room()


def _ignore(*_: object) -> None:
    """Does nothing: the stream has ended."""
