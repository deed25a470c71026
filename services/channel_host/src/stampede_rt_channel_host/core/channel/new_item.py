"""The items of a run on their way to the copies of their channel. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.run import ABSENT, ITEM_OVERHEAD_BYTES, Body, SingleItemRun, Slice
from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart


class NewItem(NamedTuple):
    """A run that a channel has accepted as a whole and stores as its next item, or as its next items.

    `seq` and `first_number` are those of the first item. `time`: the earliest time. `duration`: the duration of a
    single item; -1 for none, and for several items. `length`: the length of all payloads. `is_stamped`: the owner has
    given the items their time. `judged_at`: the owner's clock. `body`: as in `Run`. `caller_name`: the name of the
    caller, as in `KeptRun`; the copies know it already. A copy without the owner's facts does not need `producer_id`,
    `first_number`, `is_stamped` and `judged_at`, and gets zeros.
    """

    seq: int
    producer_id: int
    first_number: int
    time: int
    duration: int
    length: int
    is_stamped: bool
    judged_at: int
    body: Body
    caller_name: str = ""
    items: int = 1

    @property
    def end_seq(self) -> int:
        """The seq after the last item's seq."""
        return self.seq + self.items

    @property
    def charge_bytes(self) -> int:
        """The bytes that the items cost a copy's credit."""
        return self.length + self.items * ITEM_OVERHEAD_BYTES

    def kept_run(self, now: int, caller_name: str) -> KeptRun:
        """The run for a retry window. `now`: the clock of the window's host."""
        part = RunPart(0, self.seq, self.items, self.time if self.is_stamped else None)
        outcome = RunOutcome(self.items, self.items, (part,), (), now)
        return KeptRun(self.producer_id, self.first_number, outcome, caller_name)


def new_item(part: Slice) -> NewItem | None:
    """A run that the channel has stored, for copies without the owner's facts. None if the slice is a part of a run."""
    run = part.run
    if isinstance(run, SingleItemRun):
        return NewItem(run.first_seq, 0, 0, run.first_time, run.duration, run.length, False, 0, run.body)
    if not part.is_whole:
        return None
    durations = run.durations if part.items == 1 else None
    duration, length = ABSENT if durations is None else durations[0], part.payload_bytes
    return NewItem(run.first_seq, 0, 0, part.first_time, duration, length, False, 0, run.body, items=part.items)


class NewFloor(NamedTuple):
    """The fields of a `CollectionFacts` that change while a channel collects items for one cause."""

    floor: ItemKey
    newest_collected: int
    collected_end: int


class FedItem(NamedTuple):
    """A part of a feed: the items of a run, and the items collected before. `collected` None: as in the last part."""

    item: NewItem
    collected: NewFloor | None
