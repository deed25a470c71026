"""Brings the events of each channel into the order in which its host had them. Pure."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from itertools import count

from stampede_rt.files.chunk_content import Event
from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.files.seq_ranges import SeqRanges

WAITING_BYTES_MAX = 64 * 1024 * 1024
EVENT_BYTES = 512  # the memory of an event besides its payload
Key = tuple[str, int]
Waiting = tuple[int, int, int, Event]  # the event's seq, its rank at this seq, its number in the order of arrival


class SeqOrder:
    """Passes events on to `take`. An item waits for the items of its channel with earlier seqs.

    `held` has the seqs of all items that the caller will add. If more than 64 MiB of events wait, the object passes all
    of them on.
    """

    def __init__(self, held: Mapping[Key, SeqRanges], take: Callable[[Event], object]) -> None:
        self._held, self._take = held, take
        self._last: dict[Key, int] = {}  # the greatest seq that was passed on
        self._waiting: dict[Key, list[Waiting]] = {}
        self._waiting_bytes = 0
        self._numbers = count()

    def add(self, event: Event) -> None:
        """Take an event, and pass on all events that need not wait for another event."""
        key, place = _place_of(event)
        if place is None or key not in self._held:
            self._take(event)
            return
        heapq.heappush(self._waiting.setdefault(key, []), (*place, next(self._numbers), event))
        self._waiting_bytes += _bytes_of(event)
        self._release(key)
        if self._waiting_bytes > WAITING_BYTES_MAX:
            self.finish()

    def _release(self, key: Key) -> None:
        waiting = self._waiting[key]
        while waiting:
            expected = self._held[key].next_from(self._last.get(key, -1) + 1)
            seq, rank, *_ = waiting[0]
            if expected is not None and (expected, 1) < (seq, rank):
                return
            self._pass_on(key)

    def _pass_on(self, key: Key) -> None:
        seq, _, _, event = heapq.heappop(self._waiting[key])
        self._waiting_bytes -= _bytes_of(event)
        if isinstance(event, FileEntry):
            self._last[key] = max(seq, self._last.get(key, -1))
        self._take(event)

    def finish(self) -> None:
        """Pass on everything, channel by channel."""
        for key, waiting in self._waiting.items():
            while waiting:
                self._pass_on(key)


def _place_of(event: Event) -> tuple[Key, tuple[int, int] | None]:
    """Return the channel of an event, and its place there: gaps before the item of the same seq, advances after it."""
    if isinstance(event, FileEntry):
        key = (event.topic.name, event.topic.incarnation or 0)
        return key, None if event.seq is None or event.topic.incarnation is None else (event.seq, 1)
    if isinstance(event, FileAdvance):
        return (event.channel, event.incarnation), (event.after_seq, 2)
    return (event.channel, event.incarnation), None if event.first_seq is None else (event.first_seq, 0)


def _bytes_of(event: Event) -> int:
    return EVENT_BYTES + (len(event.data) if isinstance(event, FileEntry) else 0)
