"""Sends the items of one channel to the multicast group. It is an observer of the channel, like a subscription.

It keeps a cursor into the channel, and no queue. If the rate is too low, or retention is faster than the rate, readers
miss datagrams and ask the host for the items.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from stampede_rt.errors import StampedeError
from stampede_rt.multicast.encryption import Encryptor, Signer
from stampede_rt.multicast.layout import (
    KEY_BYTES,
    MESSAGE_BYTES_MAX,
    STREAM_ID_BYTES,
    MessageKind,
    MulticastMessage,
    parts_of,
)
from stampede_rt.multicast.repair_pace import BEAT_S_MAX
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.multicast.group_socket import MulticastGroup
from stampede_rt_channel_host.core.channel import AllCursor, DeliveredSlice

ITEMS_BYTES = 8192
"""The approximate size of a message with several items.

Messages are short, because the loss of one datagram loses its whole message.
"""
BEAT_S_MIN = 0.02  # the silence before the first beat, which tells readers the last seq. Grows up to BEAT_S_MAX
LATE_S_MAX = 1.0
"""A multicast that is behind its channel for longer leaves items out. Otherwise its lag would have no limit."""
KEY_SECONDS_MIN = 10.0  # the least time between two keys. So a reader that has left can decrypt for this time at most
KEY_NUMBERS_MAX = 2**16 - 1


@dataclass(frozen=True, slots=True)
class OfferedStream:
    """The facts that a reader needs to receive the datagrams."""

    group: str
    stream_id: bytes
    key_number: int
    key: bytes
    public_key: bytes


class ChannelMulticast:
    """Order of use, on one event loop: make it, `run` as a task, `join` and `leave` for each reader, `stop`.

    `readers`: the subscriptions whose readers may receive the datagrams. `repairs`: their requests for missing items.
    `has_ended`: it sends nothing more, and new readers need another multicast.
    """

    def __init__(self, hosted: HostedChannel, group: MulticastGroup, now: Callable[[], int]) -> None:
        self._hosted, self._group, self._now = hosted, group, now
        self._stream_id = secrets.token_bytes(STREAM_ID_BYTES)
        self._signer = Signer(self._stream_id, secrets.token_bytes(KEY_BYTES))
        self._key_number = self._beats = self.readers = self.repairs = self.datagrams = self.bytes = 0
        self._wakeup = asyncio.Event()
        self.has_ended = self._owes_key = False
        self._beat_s = BEAT_S_MIN
        # a next seq of the channel, and the loop time at which the channel had it; kept until all items before it are
        # sent
        self._goal_seq, self._goal_s = 0, 0.0
        self._renew_key()

    @property
    def offer(self) -> OfferedStream:
        """The present facts. `key_number` changes with the key."""
        return OfferedStream(self._group.address, self._stream_id, self._key_number, self._key, self._signer.public_key)

    def wake(self) -> None:
        """See `ChannelObserver`."""
        self._wakeup.set()

    def end(self, error: StampedeError) -> None:
        """See `ChannelObserver`. A last datagram makes the readers open streams, which give the reason."""
        self.has_ended = True
        self._wakeup.set()

    def join(self) -> None:
        """Note one more reader."""
        self.readers += 1

    def leave(self) -> None:
        """Note that a reader has left. It must not decrypt later datagrams, so the key changes soon."""
        self.readers -= 1
        self._owes_key = True

    async def run(self) -> None:
        """Send the items that the channel accepts from now on, until `end`, or until somebody cancels the task."""
        cursor = AllCursor(iter(()), self._hosted.channel.next_seq)
        self._hosted.group_observers[self] = None
        try:
            while not self.has_ended:
                cursor = self._in_time(cursor)
                await self._step(cursor)
            await self._send(MessageKind.END, cursor.next_seq, cursor.next_seq, self._next_beat())
        finally:
            self.has_ended = True  # also after a defect: the next reader begins another multicast
            self._hosted.group_observers.pop(self, None)

    def _in_time(self, cursor: AllCursor) -> AllCursor:
        """The cursor, or a new cursor at the end of the channel if the cursor has been behind for too long.

        Readers ask the host for the items between the two, or continue without datagrams.
        """
        next_seq, now_s = self._hosted.channel.next_seq, asyncio.get_running_loop().time()
        if cursor.next_seq < self._goal_seq and now_s - self._goal_s > LATE_S_MAX:
            cursor = AllCursor(iter(()), next_seq)
        if cursor.next_seq >= self._goal_seq:
            self._goal_seq, self._goal_s = next_seq, now_s
        return cursor

    async def _step(self, cursor: AllCursor) -> None:
        """Send the next items, or wait for some. Sends a beat after a silence."""
        self._wakeup.clear()
        self._renew_owed_key()
        part = self._hosted.channel.since(cursor, self._now(), ITEMS_BYTES)
        if part.slices:
            self._beat_s = BEAT_S_MIN
            await self._send_items(part.slices)
        elif part.is_empty and not part.more:
            await self._wait(cursor)
        else:  # the items left before they were sent: readers ask the host, which reports the gap
            await asyncio.sleep(0)

    async def _send_items(self, slices: Sequence[DeliveredSlice]) -> None:
        """Send items in one message, or in several if attributes make it long. Leaves out an item that is too long."""
        first_seq, end_seq = slices[0].slice.first_seq, slices[-1].slice.end_seq
        delivery = self._hosted.deliveries.encode(slices, b"", without_payloads=False, readers=1)
        if len(delivery.encoded) <= MESSAGE_BYTES_MAX:
            self._hosted.count_delivered(end_seq - first_seq, delivery.payload_bytes)
            await self._send(MessageKind.ITEMS, first_seq, end_seq, delivery.encoded)
        elif len(slices) > 1:
            for some in (slices[: len(slices) // 2], slices[len(slices) // 2 :]):
                await self._send_items(some)
        await asyncio.sleep(0)

    async def _wait(self, cursor: AllCursor) -> None:
        """Wait for items. Sends a beat after a silence."""
        with suppress(TimeoutError):
            async with asyncio.timeout(self._beat_s):
                await self._wakeup.wait()
                return
        self._beat_s = min(2 * self._beat_s, BEAT_S_MAX)
        await self._send(MessageKind.BEAT, cursor.next_seq, cursor.next_seq, self._next_beat())

    async def _send(self, kind: MessageKind, first_seq: int, end_seq: int, body: bytes) -> None:
        message = self._signer.sign(MulticastMessage(kind, first_seq, end_seq, body))
        await self._group.send([*parts_of(message)], self._encrypted)

    def _encrypted(self, part: bytes) -> bytes:
        """The datagram of a part, under a key that readers who have left 10 s ago do not know.

        At a low rate the parts of one message may take longer.
        """
        self._renew_owed_key()
        datagram = self._encryptor.encrypt(part)
        self.datagrams += 1
        self.bytes += len(datagram)
        return datagram

    def _next_beat(self) -> bytes:
        self._beats += 1
        return self._beats.to_bytes(8, "big")

    def _renew_owed_key(self) -> None:
        """Change the key if a reader has left, and the key is old enough."""
        if self._owes_key and asyncio.get_running_loop().time() - self._key_at_s >= KEY_SECONDS_MIN:
            self._renew_key()

    def _renew_key(self) -> None:
        self._key_number = self._key_number % KEY_NUMBERS_MAX + 1
        self._key, self._owes_key = secrets.token_bytes(KEY_BYTES), False
        self._key_at_s = asyncio.get_running_loop().time()
        self._encryptor = Encryptor(self._stream_id, self._key_number, self._key)
