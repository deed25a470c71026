"""A change that may release blocked gets, and the states of a channel in which the host looks for their answers."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from operator import attrgetter
from typing import Protocol

from stampede_rt_channel_host.channels.gets.waiting_get import WaitingGet
from stampede_rt_channel_host.core.channel import (
    PendingGet,
    Pieces,
    Reach,
    ReadAnswer,
    WakeAt,
)
from stampede_rt_channel_host.core.keyed_list import KeyedList


class PolledSource(Protocol):
    """An object in which blocked gets look for their answers: a `Source`, or a snapshot of one."""

    def polling(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """See `ChannelCore.polling`."""


class SourceSnapshot(PolledSource, Protocol):
    """A `Source` as it was at one moment."""

    def close(self) -> None:
        """Free the snapshot. The host polls no get with it any more."""


class Source(PolledSource, Protocol):
    """The source that gets wait for: a channel, or the visible part of a channel in a group."""

    def giving_up(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer]:
        """See `ChannelCore.giving_up`."""

    def snapshot(self, now: int) -> SourceSnapshot:
        """See `ChannelCore.snapshot`."""


class GetRelease:
    """One change, and the gets that it may release: they arrived before the change, and it may fulfil their needs."""

    def __init__(self, reach: Reach, arrivals: int) -> None:
        self.reach = reach
        self.arrivals = arrivals  # the `arrival` of the last get before the change
        self.snapshot: SourceSnapshot | None = None  # the state right after the change
        self.taken: deque[WaitingGet] = deque()  # gets that `take` returned, and that nobody has looked at yet
        # for each kind of need, the sort key of the last get that `take` has looked at
        self._last_keys: list[tuple[int, int] | None] = [None] * len(reach)

    def merge(self, later: GetRelease) -> None:
        """Join a later change.

        The joined change has the state of the later one. Allowed only before the first `take`.
        """
        pairs = zip(self.reach, later.reach, strict=True)
        self.reach = Reach(*(max((one for one in pair if one is not None), default=None) for pair in pairs))
        self.arrivals = later.arrivals

    def take(self, by_need: Sequence[KeyedList[WaitingGet]], gets_max: int) -> list[WaitingGet]:
        """The next gets that the change may release, at most `gets_max`, in the order of arrival.

        Between two calls, gets may be released or cancelled.
        """
        found: dict[WaitingGet, None] = {}
        for position, (ordered, reached) in enumerate(zip(by_need, self.reach, strict=True)):
            if reached is None:
                continue
            for get in ordered.after(self._last_keys[position], (reached, self.arrivals), gets_max - len(found)):
                self._last_keys[position] = ordered.key(get)
                if get.arrival <= self.arrivals:
                    found[get] = None
        return sorted(found, key=attrgetter("arrival"))

    def close(self) -> None:
        """Free the snapshot, if there is one."""
        if self.snapshot is not None:
            self.snapshot.close()
