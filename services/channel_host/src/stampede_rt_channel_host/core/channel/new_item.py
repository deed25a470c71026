"""The items of a run on their way to the copies before their channel stores them. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.run import Body
from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart


class NewItem(NamedTuple):
    """A run that a channel has accepted as a whole and is about to store as its next item, or as its next items.

    `seq` and `first_number` are those of the first item. `time`: the earliest time. `duration`: the duration of a
    single item; -1 for none, and for several items. `length`: the length of all payloads. `is_stamped`: the owner has
    given the items their time. `judged_at`: the owner's clock. `body`: as in `Run`. `owner`: the name of the caller, as
    in `KeptRun`; the copies know it already.
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
    owner: str = ""
    items: int = 1

    @property
    def end_seq(self) -> int:
        """The seq after the last item's seq."""
        return self.seq + self.items

    def kept_run(self, now: int, owner: str) -> KeptRun:
        """The run for a retry window. `now`: the clock of the window's host."""
        part = RunPart(0, self.seq, self.items, self.time if self.is_stamped else None)
        outcome = RunOutcome(self.items, self.items, (part,), (), now)
        return KeptRun(self.producer_id, self.first_number, outcome, owner)


class NewFloor(NamedTuple):
    """The fields of a `CollectionFacts` that change while a channel collects items for one cause."""

    floor: ItemKey
    newest_collected: int
    collected_end: int


class FedItem(NamedTuple):
    """A part of a feed: the items of a run, and the items collected before. `collected` None: as in the part before."""

    item: NewItem
    collected: NewFloor | None
