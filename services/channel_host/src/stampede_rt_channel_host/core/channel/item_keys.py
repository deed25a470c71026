"""Item keys: pairs that sort in the order in which reads return items. Pure."""

from __future__ import annotations

from stampede_rt.matching.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey

__all__ = ["FIRST_KEY", "LAST_KEY", "SEQ_END", "ItemKey"]
