"""Item keys: pairs that sort in the order in which reads return items. Pure."""

from __future__ import annotations

ItemKey = tuple[int, int]
"""The time and seq of an item. Keys sort in the order in which reads return items."""

SEQ_END = 1 << 64
"""A number greater than every seq."""

FIRST_KEY: ItemKey = (-(1 << 64), 0)
"""A key below the keys of all items."""

LAST_KEY: ItemKey = (1 << 64, 0)
"""A key above the keys of all items."""
