"""The outbox writes all answers of a stream: one message of each in turn, within its bounds. It needs no task to
write a single message that the reader takes immediately.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator

from stampede_rt_channel_host.channels.frames import EncodedMessage
from stampede_rt_channel_host.channels.gets.outbox import ANSWERS_QUEUED_MAX, QUEUED_BYTES_MAX, Outbox
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.channel import Pieces, Slice
from stampede_rt_channel_host.core.channel.run import SingleItemRun
from stampede_rt_channel_host.core.channel.slices_in_parts import SlicesInParts


class Context:
    """The context of a handler. While `open` is not set, the peer takes nothing."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.open = asyncio.Event()
        self.open.set()
        self.begun = asyncio.Event()

    async def write(self, message: bytes) -> None:
        self.begun.set()
        await self.open.wait()
        self.written.append(message)


class OutboxRig:
    """An outbox, and its effects: the ended calls, the payload bytes sent, and the long work that it began."""

    def __init__(self) -> None:
        task = asyncio.current_task()
        assert task is not None
        self.context = Context()
        self.ended: list[int] = []
        self.sent = 0
        self.begun: list[Pieces[None]] = []
        self.outbox = Outbox(self.context, OpenStream(task), self.ended.append, begin=self.begun.append)

    def add(self, call_id: int, messages: int = 1) -> None:
        self.outbox.add(call_id, answer(call_id, messages), self.count)

    def count(self, items: int, payload_bytes: int) -> None:
        self.sent += payload_bytes


def answer(call_id: int, messages: int) -> Iterator[EncodedMessage]:
    for place in range(messages):
        yield EncodedMessage(b"%d.%d" % (call_id, place), 10, place == messages - 1)


async def test_a_single_message_is_written_by_the_caller_itself() -> None:
    box = OutboxRig()
    tasks = len(asyncio.all_tasks())
    box.add(1)
    await box.outbox.flush()
    assert (box.context.written, box.ended, box.sent) == ([b"1.0"], [1], 10)
    assert len(asyncio.all_tasks()) == tasks


async def test_answers_to_several_gets_are_written_in_turns() -> None:
    box = OutboxRig()
    box.add(1, messages=3)
    box.add(2)
    box.add(3, messages=2)
    await box.outbox.flush()
    await box.outbox.finish()
    assert box.context.written == [b"1.0", b"2.0", b"3.0", b"1.1", b"3.1", b"1.2"]
    assert box.ended == [2, 3, 1]
    assert box.sent == 60


async def test_a_dropped_call_gets_no_further_messages() -> None:
    box = OutboxRig()
    box.context.open.clear()
    box.add(1, messages=3)
    box.add(2)
    box.outbox.kick()
    await box.context.begun.wait()
    box.outbox.drop(1)
    box.context.open.set()
    await box.outbox.finish()
    assert box.context.written == [b"1.0", b"2.0"]


async def test_a_stream_with_too_many_queued_answers_waits_until_they_are_written() -> None:
    box = OutboxRig()
    box.context.open.clear()
    for call_id in range(ANSWERS_QUEUED_MAX + 2):
        box.add(call_id)
    flushing = asyncio.create_task(box.outbox.flush())
    await box.context.begun.wait()
    assert not flushing.done()
    box.context.open.set()
    await flushing
    await box.outbox.finish()
    assert len(box.context.written) == ANSWERS_QUEUED_MAX + 2


async def test_a_closed_outbox_writes_no_more() -> None:
    box = OutboxRig()
    box.context.open.clear()
    box.add(1)
    box.add(2)
    box.outbox.kick()
    await box.context.begun.wait()
    box.outbox.close()
    box.context.open.set()
    box.outbox.kick()
    assert box.context.written == []


async def test_answers_are_bounded_by_the_bytes_that_they_keep() -> None:
    box = OutboxRig()
    box.context.open.clear()
    for call_id in range(3):
        box.outbox.add(call_id, answer(call_id, 1), box.count, QUEUED_BYTES_MAX // 2 + 1)
    assert not box.outbox.has_room
    held_back = asyncio.ensure_future(box.outbox.flush())
    await box.context.begun.wait()
    assert not held_back.done()
    box.context.open.set()
    await held_back
    await box.outbox.finish()
    assert (box.outbox.queued_bytes, box.outbox.has_room) == (0, True)


async def test_a_dropped_answer_frees_its_items_and_makes_room() -> None:
    box = OutboxRig()
    box.outbox.add(1, answer(1, 1), box.count, 10 * QUEUED_BYTES_MAX)
    box.outbox.drop(1)
    assert (box.outbox.queued_bytes, box.ended) == (0, [1])


def gathered(parts: int) -> SlicesInParts:
    return SlicesInParts(deque([Slice(SingleItemRun(seq, seq, -1, 1, b"x"), 0, 1)] for seq in range(1, parts + 1)))


async def test_unsent_items_of_a_dropped_call_or_an_ended_stream_are_freed_in_pieces() -> None:
    box, one, other = OutboxRig(), gathered(5), gathered(7)
    box.outbox.add(1, answer(1, 1), box.count, slices=one)
    box.outbox.add(2, answer(2, 1), box.count, slices=other)
    box.outbox.drop(1)
    box.outbox.close()
    assert (len(one), len(other)) == (5, 7)
    assert [sum(1 for _ in rest) for rest in box.begun] == [5, 7]
    assert not one
    assert not other


async def test_an_answer_after_the_end_of_the_stream_is_freed_and_not_written() -> None:
    box = OutboxRig()
    box.outbox.close()
    box.add(1)
    box.outbox.kick()
    await asyncio.sleep(0)
    assert (box.context.written, box.outbox.has_room, len(box.begun)) == ([], True, 1)
