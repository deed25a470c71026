"""A group's cut of an earlier instant, and the reason if the archives may not show the whole cut. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from stampede_rt.values.answers import Items
from stampede_rt.values.model import Reason
from stampede_rt.values.timeline import MIN_INSTANT


class PastMark(NamedTuple):
    """How far a channel had come at an instant: the time of its newest item then, and its highest advance.

    `reason`: why the channel may have come further than its archive shows; None: the archive is complete.
    `next_change`: when its host next accepted items or an advance; None: it has not done so yet.
    """

    name: str
    newest: int | None
    advance: int | None
    reason: Reason | None
    next_change: int | None

    @property
    def instant(self) -> int | None:
        """The later of `newest` and `advance`; None if it had neither."""
        return max((one for one in (self.newest, self.advance) if one is not None), default=None)


class PastCut(NamedTuple):
    """A group's cut of an earlier instant.

    `cut` is MIN_INSTANT if the group showed nothing. `reason`: why the group may have shown more than the items before
    `cut`; None: the cut is exact. `next_change`: when the host of a member that decides the cut next
    accepted items or an advance; None: no host has done so yet.
    """

    cut: int
    reason: Reason | None
    next_change: int | None


def past_cut_of(marks: Sequence[PastMark]) -> PastCut:
    """Return the cut: the least of the marks of the members that decide it. The marks come from their archives.

    If an archive lacks items, the mark of its channel may be too low. This matters only if this mark is the least one.
    """
    low = min(_least(one) for one in marks)
    exact = [_least(one) for one in marks if one.reason is None]
    behind = next((one for one in marks if one.reason is not None and _least(one) == low), None)
    reason = None
    if behind is not None and behind.reason is not None and low not in exact:
        detail = f"channel {behind.name} held back the earlier cut, and may have come further: {behind.reason.detail}"
        reason = Reason(behind.reason, detail)
    changes = [one.next_change for one in marks if one.next_change is not None]
    return PastCut(low, reason, min(changes, default=None))


def _least(mark: PastMark) -> int:
    return MIN_INSTANT if mark.instant is None else mark.instant


def add_reason(items: Items, reason: Reason | None) -> Items:
    """Note in an answer at a past cut that the cut may have been higher. Returns the answer.

    A complete answer stays as it is, because it is before the cut. An answer with the reason COLLECTED or LOST keeps
    this reason.
    """
    if reason is not None and not items.complete and items.reason not in (Reason.COLLECTED, Reason.LOST):
        items.reason = reason
    return items
