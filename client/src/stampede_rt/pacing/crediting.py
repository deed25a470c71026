"""How far a host may send ahead of a reader (decision 0064). Pure: it is told the time."""

from __future__ import annotations

ITEM_OVERHEAD_BYTES = 64
"""What an item takes beside the length of its payload."""

WINDOW_BYTES_MAX = 2**20
WINDOW_AGE_S = 0.1
ONE_ITEM = 1


class CreditWindow:
    """What a reader lets a host send before it is asked for, in bytes: the next item while any of it is left.

    It begins with one item, doubles with each step of the reader, and never exceeds what the reader took in
    WINDOW_AGE_S at its last step, nor `bytes_max`: so what waits on the way is young, however slow the reader is. With
    ONE_ITEM nothing is sent before the reader asks, so that it gets the newest.

    Each step of the reader: `ask`, which tells what to grant, then `take` with what it is given.
    """

    def __init__(self, bytes_max: int = WINDOW_BYTES_MAX) -> None:
        self._bytes_max = bytes_max
        self._window = 1
        self._open = 0  # granted, and not taken yet; below 0: the last item was larger than what was left
        self._last_bytes = 1
        self._taken_s: float | None = None

    def begin(self) -> None:
        """On a new stream nothing is granted yet."""
        self._open = 0

    def ask(self, now_s: float) -> int:
        """The reader wants the next item: what to grant for it, 0 for nothing."""
        self._measure(now_s)
        wanted = self._window - self._open
        if self._open > 0 and wanted * 2 < self._window:
            return 0
        self._open += wanted
        return wanted

    def take(self, item_bytes: int, now_s: float) -> None:
        """The reader is given an item, which takes so much."""
        self._open -= item_bytes
        self._last_bytes = item_bytes
        self._taken_s = now_s

    def drop(self, item_bytes: int) -> None:
        """An item came that is not given to the reader, since it has it."""
        self._open -= item_bytes

    def _measure(self, now_s: float) -> None:
        """What the reader took since its last step shows how much it takes in WINDOW_AGE_S."""
        if self._taken_s is None:
            return
        busy_s, self._taken_s = now_s - self._taken_s, None
        window = max(1, min(2 * max(self._window, self._last_bytes), self._bytes_max))
        if busy_s * window > self._last_bytes * WINDOW_AGE_S:
            window = max(1, int(self._last_bytes * WINDOW_AGE_S / busy_s))
        self._window = window
