"""The newest item of a ring. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.ring.layout import NEWEST_SLOT, NEXT_SEQ, NO_ITEMS
from stampede_rt.ring.ring_view import RingView, Slot


class FoundNewest(NamedTuple):
    """The newest item: the last item of the run `body`, or a plain item with the payload `body`.

    `is_plain`: the run has this item only, without labels.
    """

    slot: Slot
    body: bytes
    is_plain: bool
    next_seq: int


def find_newest(view: RingView, facts: list[int], after: tuple[int, int] | None = None) -> FoundNewest | bool:
    """Return the newest item, if it is later than `after`, a time and a seq.

    False: there is no such item. True: only the host can answer.
    """
    number = facts[NEWEST_SLOT]
    if number < 0:
        return number != NO_ITEMS
    slot = view.slot(number)
    if after is not None and (slot.last_time, slot.seq + slot.items - 1) <= after:
        return not view.is_whole(number)
    body = view.copy_item(slot)
    if body is None or slot.items < 1 or number < view.oldest_slot(facts) or not view.is_whole(number):
        return True
    return FoundNewest(slot, body, slot.is_plain, facts[NEXT_SEQ])
