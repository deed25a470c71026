"""Merges the items of several channels in the order of their times. Pure.

The merge waits for a channel that has no item at the moment, but only for `wait_s`: then the channel counts as quiet.
An item is late if the merge has given out an item with a later time. The merge gives out a late item immediately.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from stampede_rt.values.model import Item

CHANNEL_ITEMS_MAX = 64  # waiting items of one channel
# The bytes of the waiting payloads of one channel; a longer item may wait if no other item waits.
CHANNEL_BYTES_MAX = 256 * 1024
ALL_BYTES_MAX = 64 * 1024 * 1024  # the bytes of all waiting payloads; each channel may exceed them by one item


class MergedItem(NamedTuple):
    """An item of the merged stream. `late`: its time is before the time of an item that came out earlier."""

    channel: str
    item: Item
    late: bool


@dataclass(slots=True)
class _WaitingItems:
    """The waiting items of one channel. `empty_since_s`: when the channel joined, or its last item came out."""

    empty_since_s: float
    has_ended: bool = False
    items: deque[Item] = field(default_factory=deque)
    held_bytes: int = 0


class TimeMerge:
    """Takes the items of each channel in the order of the channel, and gives out all items by time."""

    def __init__(self, wait_s: float) -> None:
        self._wait_s = wait_s
        self._channels: dict[str, _WaitingItems] = {}
        self._last_time: int | None = None
        self._held_bytes = 0

    def join(self, channel: str, now_s: float) -> None:
        """Begin to wait for items of a channel. The channel may have ended before."""
        waiting = self._channels.setdefault(channel, _WaitingItems(now_s))
        waiting.empty_since_s, waiting.has_ended = now_s, False

    def leave(self, channel: str) -> None:
        """Stop waiting for a channel that has ended. Its waiting items come out as before."""
        self._channels[channel].has_ended = True
        self._forget(channel)

    def has_room(self, channel: str) -> bool:
        """Whether the merge takes another item of the channel now."""
        waiting = self._channels[channel]
        has_place = len(waiting.items) < CHANNEL_ITEMS_MAX and waiting.held_bytes < CHANNEL_BYTES_MAX
        return has_place and self._held_bytes < ALL_BYTES_MAX

    def offer(self, channel: str, item: Item) -> None:
        """Take the next item of a channel. The caller has asked `has_room`."""
        waiting = self._channels[channel]
        waiting.items.append(item)
        waiting.held_bytes += len(item.payload or b"")
        self._held_bytes += len(item.payload or b"")

    def take(self, now_s: float) -> MergedItem | None:
        """Return the next item; None if there is none, or if the merge still waits for a channel without items."""
        ready = [(waiting.items[0].time, name) for name, waiting in self._channels.items() if waiting.items]
        if not ready:
            return None
        time, name = min(ready)
        late = self._last_time is not None and time < self._last_time
        if not late and self.due_s() > now_s:
            return None
        waiting = self._channels[name]
        item = waiting.items.popleft()
        waiting.held_bytes -= len(item.payload or b"")
        self._held_bytes -= len(item.payload or b"")
        waiting.empty_since_s = now_s
        self._forget(name)
        self._last_time = time if self._last_time is None else max(self._last_time, time)
        return MergedItem(name, item, late)

    def due_s(self) -> float:
        """The time at which the merge no longer waits for any channel without items."""
        empty = [waiting.empty_since_s for waiting in self._channels.values() if not waiting.items]
        return max(empty, default=float("-inf")) + self._wait_s

    def _forget(self, channel: str) -> None:
        """Forget a channel that has ended and has no items."""
        waiting = self._channels[channel]
        if waiting.has_ended and not waiting.items:
            del self._channels[channel]
