"""An item on its way to the copies before its channel stores it. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.run import Body
from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart


class NewItem(NamedTuple):
    """A run of one item that a channel has accepted and is about to store as its next item.

    `duration`: -1 for none. `body`: as in `Run`. `judged_at`: the owner's clock. `is_stamped`: the owner has given the
    item its time. `owner`: the name of the caller, as in `KeptRun`; the copies know it already.
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

    def kept_run(self, now: int, owner: str) -> KeptRun:
        """The run for a retry window. `now`: the clock of the window's host."""
        part = RunPart(0, self.seq, 1, self.time if self.is_stamped else None)
        return KeptRun(self.producer_id, self.first_number, RunOutcome(1, 1, (part,), (), now), owner)


class NewFloor(NamedTuple):
    """The fields of a `CollectionFacts` that change while a channel collects items for one cause."""

    floor: ItemKey
    newest_collected: int
    collected_end: int


class FedItem(NamedTuple):
    """A part of a feed: an item, and the items collected before it. `collected` None: as in the part before."""

    item: NewItem
    collected: NewFloor | None
