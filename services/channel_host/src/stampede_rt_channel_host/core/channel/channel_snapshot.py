"""A channel as it was at one moment. Pure.

If one put releases many blocked gets, the host answers these gets in pieces, all from the same `ChannelSnapshot`.
"""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index_snapshot import IndexSnapshot
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.reading import PendingGet, QueryReader
from stampede_rt_channel_host.core.channel.retention import Retention
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.values import ReadAnswer, WakeAt


class HoldingsSnapshot:
    """The items held at one moment, with the reading methods of `Holdings`.

    The channel keeps the entries of these items in the index until `close`.
    """

    def __init__(self, held: Holdings) -> None:
        self.newest = held.newest
        self.oldest = held.oldest
        self.frontier = held.frontier
        self.gone_before = held.gone_before
        self.overlap_nanos = held.overlap_nanos
        self.collected_by = held.collected_by
        self.newest_consumed = held.newest_consumed
        self.floor = held.floor
        self.newest_collected = held.newest_collected
        self._snapshot = held.snapshot()
        self._snapshot.hold()

    @property
    def end(self) -> ItemKey:
        """See `ReadableItems`: this object shows all items."""
        return LAST_KEY

    def snapshot(self) -> IndexSnapshot:
        """A separate snapshot of the items held at that moment. It stays valid after `close` of this object."""
        return self._snapshot.copy()

    def slices_down(self, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY) -> Iterator[Slice]:
        """See `HeldItems.slices_down`."""
        return (part for part in self._snapshot.slices_down(low, high) if self._snapshot.shows(part))

    def next_time(self, time: int) -> int | None:
        """The time of the next bucket after `time`, or None if there is none."""
        return self._snapshot.next_time(time, LAST_KEY)

    def last_time_up_to(self, time: int) -> int | None:
        """The time of the last bucket at or before `time`, or None if there is none."""
        last = next(self.slices_down(FIRST_KEY, (time, SEQ_END)), None)
        return None if last is None else last.last_time

    def close(self) -> None:
        """Stop holding the entries. Idempotent."""
        self._snapshot.close()


class ChannelSnapshot:
    """A channel as it was at one moment.

    Reads answer as of that moment, whatever the channel has accepted or collected since.
    """

    def __init__(
        self, held: Holdings, retention: Retention, incarnation: int, lost_before: int | None, advance: int | None,
        clock: int,
    ) -> None:  # fmt: skip
        """`clock`: the time of the host's clock when the channel last made items outdated."""
        self.incarnation = incarnation
        self.lost_before = lost_before
        self.lost_from: int | None = None  # see `QueryReader`
        self.advanced_to = advance
        self.clock = clock
        self._held = HoldingsSnapshot(held)
        self._retention = retention

    def look(self, now: int) -> tuple[HoldingsSnapshot, Retention]:
        """See `ChannelCore.look`. Ignores `now`."""
        return self._held, self._retention

    def polling(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """See `ChannelCore.polling`. Ignores `now`."""
        reading = QueryReader(self._held, self._retention, self.incarnation, self.lost_before)
        reading.lost_from = self.lost_from
        reading.advance, reading.consumed_up_to = self.advanced_to, self._held.newest_consumed
        found = yield from reading.poll(pending, self.clock)
        return WakeAt(found.instant, reading.needs(pending)) if isinstance(found, WakeAt) else found

    def close(self) -> None:
        """Let the channel free the items of the snapshot again. Idempotent."""
        self._held.close()
