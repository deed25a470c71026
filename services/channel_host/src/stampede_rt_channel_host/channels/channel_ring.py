"""Copies the newest runs of one channel to shared memory (decision 0168)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from itertools import islice

from stampede_rt.ring.layout import CHANGES_WORD, PAYLOAD_BEGIN_MAX, WORD_BYTES
from stampede_rt.transports import futexes
from stampede_rt.wire.runs import plain_payload_at
from stampede_rt_channel_host.channels.frames import run_bytes
from stampede_rt_channel_host.channels.ring_memory import RingMemory
from stampede_rt_channel_host.core.channel import ABSENT, ChannelCore, ReferencedBody, Slice
from stampede_rt_channel_host.core.ring_sizes import RecentRuns, RingFit
from stampede_rt_channel_host.core.ring_writer import ClockReading, RingRun, RingWriter

FILLED_BYTES_MAX = 2**20  # the most bytes of held items in a new ring, so that its beginning takes no long step
FILLED_SLICES_MAX = 64


class ChannelRing:
    """A ring, and the memory in which the host writes it."""

    def __init__(
        self, channel: ChannelCore, memory: RingMemory, fit: RingFit, clock: Callable[[], ClockReading]
    ) -> None:
        """The caller must check first that `newest_run_bytes` is at most what `fit` allows."""
        self.fit = fit
        self.memory = memory
        self.readers = 0
        self.is_open = True
        self.ended = asyncio.Event()
        self.on_closed: Callable[[], None] | None = None
        self.refused_bytes = 0
        """The length of the run that was too long for this ring; 0: there was none."""
        self.reviewed_s = asyncio.get_running_loop().time()
        """The time at which the host last compared the ring with its channel's runs."""
        self.recent_runs = RecentRuns(0)
        self._channel, self._clock = channel, clock
        self._changes_address = futexes.address_of(memory.mapped) + CHANGES_WORD * WORD_BYTES
        self._writer = RingWriter(memoryview(memory.mapped), memory.size, channel.incarnation, channel.newest)
        self._next_seq = channel.next_seq
        self._begin()

    def _begin(self) -> None:
        """Write the newest held items that follow each other without a gap in seq, and in the order of time."""
        slices: list[Slice] = []
        filled_bytes = 0
        for part in islice(self._channel.newest_slices(), FILLED_SLICES_MAX):
            if slices and (part.end_seq != slices[-1].first_seq or filled_bytes > FILLED_BYTES_MAX):
                break
            filled_bytes += len(part.run.body)
            slices.append(part)
        for part in reversed(slices):
            self._append(part)
        self._writer.publish(self._channel.ring_facts(), self._clock())

    def follow(self) -> bool:
        """Write the newly accepted items and the present facts, and wake the readers.

        Returns False if a run is too long for this ring. The caller must then close it. The next ring may be larger.
        """
        for part in self._channel.accepted_from(self._next_seq):
            if not self._append(part):
                return False
        self._next_seq = self._channel.next_seq
        self._writer.publish(self._channel.ring_facts(), self._clock())
        futexes.wake(self._changes_address)
        return True

    def _append(self, part: Slice) -> bool:
        body, begin = _body_of(part)
        self.recent_runs.note(len(body))
        if len(body) > self.fit.longest_run:
            self.refused_bytes = len(body)
            return False
        duration, payload = ABSENT, 0
        if part.items == 1:
            durations = part.run.durations
            duration = ABSENT if durations is None else durations[part.lo]
            payload = part.payload_bytes << 16 | begin if 0 < begin <= PAYLOAD_BEGIN_MAX else 0
        self._writer.append(
            RingRun(part.first_seq, part.items, part.first_time, part.last_time, body, duration, payload)
        )
        return True

    def refresh(self, fence_boottime: int) -> None:
        """Write to the ring the instant until which the host may serve, and the host's clock."""
        self._writer.set_fence(fence_boottime)
        self._writer.note_clock(self._clock())

    def close(self) -> None:
        """Tell the readers to stop, and free the host's share of the memory. Calls `on_closed` once. Idempotent."""
        if self.is_open:
            self.is_open = False
            self._writer.close()
            futexes.wake(self._changes_address)
            self._writer.release()
            self.memory.close_soon()
            self.ended.set()
            if self.on_closed is not None:
                self.on_closed()


def newest_run_bytes(channel: ChannelCore) -> int:
    """The length of the longest run that a new ring may have to take."""
    newest = islice(channel.newest_slices(), FILLED_SLICES_MAX)
    return max((len(part.run.body) for part in newest), default=0)


def _body_of(part: Slice) -> tuple[bytes | ReferencedBody, int]:
    """The encoded items of a slice, and where the payload of a plain item begins; 0: the item is not plain."""
    body = part.run.body
    if part.is_whole and isinstance(body, ReferencedBody):
        return body, body.payload_at
    encoded = run_bytes(part, without_payloads=False)
    return encoded, plain_payload_at(encoded, part.payload_bytes) if part.items == 1 else 0
