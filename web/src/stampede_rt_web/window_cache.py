"""The items of windows that are older than the items in memory. The page has read these items. Pure."""

from __future__ import annotations

from collections import OrderedDict

from stampede_rt_web.drawing import Window
from stampede_rt_web.track import ItemTrack

WINDOWS_MAX = 4  # the most windows of one channel
REREAD_NANOS = 5_000_000_000  # after this time the page reads a window again, because late items may have come


class WindowCache:
    """The tracks of the windows that pages showed last.

    Above WINDOWS_MAX, forgets the window that was read first.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[int, int], tuple[int, ItemTrack]] = OrderedDict()

    def keep(self, window: Window, track: ItemTrack, now: int) -> None:
        """Keep the track of a window, read at `now` (Unix nanoseconds)."""
        self._kept.pop((window.start, window.end), None)
        self._kept[window.start, window.end] = (now, track)
        while len(self._kept) > WINDOWS_MAX:
            self._kept.popitem(last=False)

    def track_of(self, window: Window) -> ItemTrack | None:
        """Return the track of a window; None if no read of this window is kept."""
        kept = self._kept.get((window.start, window.end))
        return None if kept is None else kept[1]

    def is_due(self, window: Window, now: int) -> bool:
        """Whether the window has to be read: for the first time, or again."""
        kept = self._kept.get((window.start, window.end))
        return kept is None or now - kept[0] >= REREAD_NANOS
