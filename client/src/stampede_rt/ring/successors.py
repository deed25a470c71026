"""The next items of a ring in the order of acceptance, for subscriptions. Pure."""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

from stampede_rt.ring.facts import age_bound, surely_held
from stampede_rt.ring.layout import HEAD, NEXT_SEQ
from stampede_rt.ring.ring_view import RingView, Slot
from stampede_rt.ring.selecting import ColumnsOf, RunPiece


class FoundNext(NamedTuple):
    """Items with consecutive seqs. `next_time`: the time of the next later bucket; None: there is none.

    `slot`: the slot of the items. `end_seq`: the seq after the last item's seq. `is_plain`: there is one item, without
    labels, and `piece.body` is its payload and not its run.
    """

    piece: RunPiece
    next_time: int | None
    slot: Slot
    end_seq: int
    is_plain: bool


def find_next(
    view: RingView, facts: list[int], seq: int, near: int, now: int, columns_of: ColumnsOf
) -> FoundNext | bool:
    """Return the next items from `seq` on; False: there are none yet; True: only the host can answer.

    `near`: the slot of the preceding items; -1: unknown. `now`: the host's clock.
    """
    if seq >= facts[NEXT_SEQ]:
        return seq > facts[NEXT_SEQ]
    found = _run_with(view, facts, seq, near)
    if found is None:
        return True
    slot, body = found
    times = (slot.first_time,) if slot.items == 1 else columns_of(body)[0]
    lo, aged = seq - slot.seq, age_bound(facts, now)
    if len(times) != slot.items or not surely_held(facts, times[lo], seq, aged):
        return True
    next_time = _next_time(view, facts, slot, columns_of)
    if next_time is True:
        return True
    piece = RunPiece(body, lo, slot.items, lo == 0)
    return FoundNext(piece, next_time, slot, slot.seq + slot.items, slot.is_plain)


def _run_with(view: RingView, facts: list[int], seq: int, near: int) -> tuple[Slot, bytes] | None:
    """Return the slot with the item `seq`, and its run, or the payload of a plain item.

    None if the ring has lost the item, or does not have it yet.
    """
    first, number = view.first_ordered(facts), near + 1
    if near < 0 or not first <= number < facts[HEAD] or view.first_seq(number) != seq:
        number = _slot_with(view, first, facts[HEAD], seq)
    if not first <= number < facts[HEAD]:
        return None
    slot = view.slot(number)
    body = view.copy_item(slot) if slot.seq <= seq < slot.seq + slot.items else None
    return None if body is None or not view.is_whole(number) else (slot, body)


def _slot_with(view: RingView, first: int, head: int, seq: int) -> int:
    """Return the last slot that begins at or before `seq`."""
    low, high = first, head
    while low < high:
        middle = (low + high) // 2
        if view.first_seq(middle) <= seq:
            low = middle + 1
        else:
            high = middle
    return low - 1


def _next_time(view: RingView, facts: list[int], slot: Slot, columns_of: ColumnsOf) -> int | bool | None:
    """Return the time of the first bucket after the slot; None if there is none, True if the ring lost it meanwhile."""
    for number in range(slot.number + 1, min(facts[HEAD], slot.number + 64)):
        later = view.slot(number)
        if later.first_time > slot.last_time:
            return later.first_time if view.is_whole(number) else True
        if later.last_time > slot.last_time:
            body = view.copy(later)
            if body is None or not view.is_whole(number):
                return True
            times = columns_of(body)[0]
            at = bisect_right(times, slot.last_time)
            return times[at] if at < len(times) else True
    return True if facts[HEAD] > slot.number + 64 else None
