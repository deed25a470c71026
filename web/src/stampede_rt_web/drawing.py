"""The drawing of a track in an interval: each item, or the number of items in each pixel. Pure.

JavaScript's numbers cannot hold nanoseconds since the epoch. So the answer gives instants as microseconds after `base`,
the start of the interval, and `base` itself as text.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stampede_rt_web.track import ABSENT, ItemTrack

PIXELS_FOR_ITEM_MIN = 3  # with fewer pixels for an item, the page draws the number of items in each pixel
WIDTH_MAX = 4096  # pixels
MARKS_SHOWN_MAX = 64  # the latest marks of the interval


@dataclass(frozen=True, kw_only=True, slots=True)
class Window:
    """The visible interval, [start, end] in nanoseconds, and its width in pixels."""

    start: int
    end: int
    width: int

    def offset_micros(self, instant: int) -> float:
        """Return the microseconds from the start of the window to `instant`."""
        return (instant - self.start) / 1000


def draw(track: ItemTrack, window: Window, *, overlap_nanos: int = 0) -> dict[str, Any]:
    """Return the drawing of a track as JSON values. The window's width limits the size of the drawing, even for very
    many items.

    `overlap_nanos`: the channel's policy `overlap`.
    """
    inside = track.between(window.start, window.end)
    drawing: dict[str, Any] = {"count": _count(track, window), "marks": _marks(track, window)}
    if track.ends_early:
        drawing["ends"] = window.offset_micros(track.times[-1])  # no item after this one was read
    if len(inside) * PIXELS_FOR_ITEM_MIN <= window.width:
        drawing["items"] = [_item(track, index, window, overlap_nanos) for index in inside]
    else:
        drawing["density"] = _density(track, inside, window)
    return drawing


def _item(track: ItemTrack, index: int, window: Window, overlap_nanos: int) -> list[float | None]:
    """Return [begin, end, seq, payload bytes]. The end of the span is None if the item has no duration."""
    time, duration = track.times[index], track.durations[index]
    end: float | None = None
    if duration != ABSENT:
        end_nanos = time + duration
        if index + 1 < len(track):
            end_nanos = min(end_nanos, max(track.times[index + 1], time + overlap_nanos))
        end = window.offset_micros(end_nanos)
    return [window.offset_micros(time), end, track.seqs[index], track.lengths[index]]


def _density(track: ItemTrack, inside: range, window: Window) -> list[int]:
    """Return the number of items that begin in each pixel."""
    counts = [0] * window.width
    span = max(1, window.end - window.start)
    for index in inside:
        pixel = (track.times[index] - window.start) * window.width // span
        if 0 <= pixel < window.width:
            counts[pixel] += 1
    return counts


def _count(track: ItemTrack, window: Window) -> int:
    return sum(1 for index in track.between(window.start, window.end) if track.times[index] >= window.start)


def _marks(track: ItemTrack, window: Window) -> list[dict[str, Any]]:
    inside = [mark for mark in track.marks if window.start <= mark.time <= window.end]
    return [
        {"at": window.offset_micros(mark.time), "kind": mark.kind, "text": mark.text}
        for mark in inside[-MARKS_SHOWN_MAX:]
    ]
