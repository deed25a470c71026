"""Computes how far a host may send ahead of a reader (decision 0064). The module is pure: the caller passes the
time."""

from __future__ import annotations

from collections.abc import Collection
from operator import attrgetter

from stampede_rt.values.columns import ItemColumns
from stampede_rt.values.model import Item

ITEM_OVERHEAD_BYTES = 64
"""The bytes that a client counts for each item besides its payload."""

WINDOW_BYTES_MAX = 2**21  # while the reader takes one message of 1 MiB, the host can send the next one
WINDOW_AGE_S = 0.1
QUICK_S = 0.001
"""A reader that works longer on a batch asks for one response, unless it takes a full window within WINDOW_AGE_S."""
_length_of = attrgetter("payload_length_bytes")
ONE_ITEM = 1
"""The window of one byte. With it the host may send one item of any size."""


def cost_of(items: Collection[Item]) -> int:
    """Return the bytes of credit that the items cost. Makes no Item of columns."""
    payload_bytes: int = items.payload_bytes if isinstance(items, ItemColumns) else sum(map(_length_of, items))
    return payload_bytes + ITEM_OVERHEAD_BYTES * len(items)


class CreditWindow:
    """The bytes that a host may send ahead of the reader. The host sends the next item while at least one byte is left.

    The window begins with one item and doubles with each step of the reader. It never exceeds `bytes_max`, nor the
    bytes that the reader takes in WINDOW_AGE_S at the speed of its last step. Sent items are therefore young when the
    reader takes them, even if the reader is slow. If `bytes_max` is ONE_ITEM, the host sends one item for each step,
    and only after the reader asks for the item.

    A reader that takes batches, and works long on each, asks for one response. Then the host sends all items that it
    has, and nothing ahead. The time that such a reader takes for a batch says little about its speed.

    At each step the reader calls `ask`, grants the host the result, and calls `take` with the item's size. If several
    items have come together, it may call `take_all` once, after the last of them.
    """

    def __init__(self, bytes_max: int = WINDOW_BYTES_MAX) -> None:
        self._bytes_max = bytes_max
        self._window = 1
        self._open = 0  # bytes that are granted and not yet taken; negative if an item was larger than the grant
        self._last_bytes = 1  # the size of the last item that the reader took
        self._taken_s: float | None = None  # when the reader took that item; None when `ask` has used this time
        self.is_for_one = False
        """Whether the last grant was for one response. The host drops the credit that this response leaves."""
        self._is_quick = True  # whether the reader worked shortly on its last batch

    def begin(self) -> None:
        """Begin a new stream. The reader has granted nothing on it yet."""
        self._open = 0

    def ask(self, now_s: float, *, for_batch: bool = False) -> int:
        """Return the bytes to grant the host; 0 if it needs no grant yet. The reader calls this before each item.

        `for_batch`: the reader will take all items that come together.
        """
        if self.is_for_one:
            self._open = 0
        if for_batch and self._taken_s is not None:
            busy_s = now_s - self._taken_s
            self._is_quick = busy_s < QUICK_S or busy_s * self._bytes_max < self._last_bytes * WINDOW_AGE_S
        self.is_for_one = for_batch and not self._is_quick and self._bytes_max > ONE_ITEM
        if self.is_for_one:
            return self._bytes_max
        self._measure(now_s)
        wanted = self._window - self._open
        if self._open > 0 and wanted * 2 < self._window:
            return 0
        self._open += wanted
        return wanted

    def take(self, item_bytes: int, now_s: float) -> None:
        """Note that the reader took an item of that size."""
        self.take_all(item_bytes, item_bytes, now_s)

    def take_all(self, items_bytes: int, last_bytes: int, now_s: float) -> None:
        """Note that the reader took several items of that size in all. It took the last one, of `last_bytes`, now."""
        self._open -= items_bytes
        self._last_bytes = last_bytes
        self._taken_s = now_s

    def drop(self, item_bytes: int) -> None:
        """Note that an item of that size came, and that the client drops it, for example because it is a repetition."""
        self._open -= item_bytes

    def _measure(self, now_s: float) -> None:
        """Double the window, but keep it within the bytes that the reader takes in WINDOW_AGE_S, and the maximum.

        The size of the last item, and the time since the reader took it, give the speed of the reader.
        """
        if self._taken_s is None:
            return
        busy_s, self._taken_s = now_s - self._taken_s, None
        window = max(1, min(2 * max(self._window, self._last_bytes), self._bytes_max))
        if busy_s * window > self._last_bytes * WINDOW_AGE_S:
            window = max(1, int(self._last_bytes * WINDOW_AGE_S / busy_s))
        self._window = window


class SteadyWindow(CreditWindow):
    """A window of a fixed size, for a reader that takes all items that have come, and works on them together."""

    def __init__(self, window_bytes: int) -> None:
        super().__init__(window_bytes)
        self._window = window_bytes

    def _measure(self, now_s: float) -> None:
        return
