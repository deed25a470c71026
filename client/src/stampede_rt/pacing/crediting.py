"""How far a host may send ahead of a reader (decision 0064). Pure: the caller brings the time."""

from __future__ import annotations

ITEM_OVERHEAD_BYTES = 64
"""The bytes that an item counts besides its payload."""

WINDOW_BYTES_MAX = 2**20
WINDOW_AGE_S = 0.1
ONE_ITEM = 1


class CreditWindow:
    """The bytes that a host may send before the reader asks for them. The host sends the next item while any are left.

    The window begins with one item and doubles with each step of the reader. It never exceeds what the reader took in
    WINDOW_AGE_S at its last step, nor `bytes_max`. Items on the way are therefore young, however slow the reader is.
    With ONE_ITEM the host sends nothing before the reader asks, so that the reader gets the newest item.

    At each step the reader calls `ask`, grants the host the result, and calls `take` with the item's size.
    """

    def __init__(self, bytes_max: int = WINDOW_BYTES_MAX) -> None:
        self._bytes_max = bytes_max
        self._window = 1
        self._open = 0  # granted and not taken yet; below 0 after an item that was larger than the rest
        self._last_bytes = 1
        self._taken_s: float | None = None

    def begin(self) -> None:
        """Begin a new stream, on which nothing is granted yet."""
        self._open = 0

    def ask(self, now_s: float) -> int:
        """Return the bytes to grant, because the reader wants the next item; 0 for none."""
        self._measure(now_s)
        wanted = self._window - self._open
        if self._open > 0 and wanted * 2 < self._window:
            return 0
        self._open += wanted
        return wanted

    def take(self, item_bytes: int, now_s: float) -> None:
        """Note that the reader took an item of that size."""
        self._open -= item_bytes
        self._last_bytes = item_bytes
        self._taken_s = now_s

    def drop(self, item_bytes: int) -> None:
        """Note that an item came that the reader already has."""
        self._open -= item_bytes

    def _measure(self, now_s: float) -> None:
        """Measure what the reader takes in WINDOW_AGE_S, by what it took since its last step."""
        if self._taken_s is None:
            return
        busy_s, self._taken_s = now_s - self._taken_s, None
        window = max(1, min(2 * max(self._window, self._last_bytes), self._bytes_max))
        if busy_s * window > self._last_bytes * WINDOW_AGE_S:
            window = max(1, int(self._last_bytes * WINDOW_AGE_S / busy_s))
        self._window = window
