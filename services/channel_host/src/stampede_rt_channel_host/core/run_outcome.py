"""The outcome of a put of one run. The channel or queue judges the items one by one, from the first item on. Pure.

While the last items of a run wait for room, only the items before them are judged. If the producer repeats such a run,
the judgement continues after the judged items.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

from stampede_rt.errors import StampedeError


class RunPart(NamedTuple):
    """Accepted items of a run, the first of them at `position`. Their seqs are consecutive, from `first_seq` on.

    `stamped_time` is the time that the host gave them, or None if the producer gave their times.
    """

    position: int
    first_seq: int
    items: int
    stamped_time: int | None


class ItemRefusal(NamedTuple):
    """A refused item: its position in the run, and the error."""

    position: int
    error: StampedeError


class RunOutcome(NamedTuple):
    """The outcome of a run of `items` items. As of `time`, the first `judged_items` items are accepted or refused.

    `parts` and `refusals` ascend in position. Nearly every run has one part and no refusals.
    """

    items: int
    judged_items: int
    parts: Sequence[RunPart]
    refusals: Sequence[ItemRefusal]
    time: int

    @property
    def is_whole(self) -> bool:
        """Whether every item is judged."""
        return self.judged_items == self.items

    @property
    def first_seq(self) -> int | None:
        """The first accepted item's seq, or None if no item was accepted."""
        return self.parts[0].first_seq if self.parts else None

    @property
    def end_seq(self) -> int:
        """The seq after the last accepted item's; 0 if no item was accepted."""
        return self.parts[-1].first_seq + self.parts[-1].items if self.parts else 0

    @property
    def stamped_time(self) -> int | None:
        """The time that the host gave the first accepted items, or None if the host gave them no time."""
        return self.parts[0].stamped_time if self.parts else None


def up_to_seq(outcome: RunOutcome, next_seq: int) -> RunOutcome:
    """The outcome as if it were judged only up to the first accepted item with the seq `next_seq` or a later one."""
    parts = [
        one._replace(items=min(one.items, next_seq - one.first_seq))
        for one in outcome.parts
        if one.first_seq < next_seq
    ]
    refused = {one.position for one in outcome.refusals}
    accepted = (at for at in range(outcome.judged_items) if at not in refused)
    lost = next(islice(accepted, sum(one.items for one in parts), None), outcome.judged_items)
    refusals = tuple(one for one in outcome.refusals if one.position < lost)
    return outcome._replace(judged_items=lost, parts=tuple(parts), refusals=refusals)


class RunProgress:
    """Collects the outcome of a run of `items` items. The first `judged_items` items are judged so far."""

    __slots__ = ("_parts", "_refusals", "items", "judged_items")

    def __init__(self, items: int) -> None:
        self.items = items
        self.judged_items = 0
        self._parts: list[RunPart] = []
        self._refusals: list[ItemRefusal] = []

    @property
    def accepted_any(self) -> bool:
        """Whether some items are accepted. The channel or queue must not accept these items again."""
        return bool(self._parts)

    @property
    def first_seq(self) -> int | None:
        """The first accepted item's seq, or None if no item was accepted."""
        return self._parts[0].first_seq if self._parts else None

    @property
    def stamped_time(self) -> int | None:
        """The time that the host gave the first accepted items, or None if the host gave them no time."""
        return self._parts[0].stamped_time if self._parts else None

    def accept(self, position: int, first_seq: int, items: int, stamped_time: int | None) -> None:
        """Note `items` accepted items, the first one at `position`, with seqs from `first_seq` on."""
        last = self._parts[-1] if self._parts else None
        if last is not None and (last.first_seq + last.items, last.stamped_time) == (first_seq, stamped_time):
            self._parts[-1] = last._replace(items=last.items + items)
        else:
            self._parts.append(RunPart(position, first_seq, items, stamped_time))

    def refuse(self, position: int, error: StampedeError) -> None:
        """Note that the item at `position` is refused."""
        self._refusals.append(ItemRefusal(position, error))

    def resume(self, known: RunOutcome) -> bool:
        """Take over the outcome `known` of an earlier put of the same run.

        Returns False, and changes nothing, if `known` has no more judged items than this object.
        """
        if known.judged_items <= self.judged_items:
            return False
        self.judged_items = known.judged_items
        self._parts, self._refusals = list(known.parts), list(known.refusals)
        return True

    def outcome(self, now: int) -> RunOutcome:
        """The outcome as of `now`."""
        return RunOutcome(self.items, self.judged_items, tuple(self._parts), tuple(self._refusals), now)
