"""The moves that a host may have under way, and the share of each caller that has created channels or queues. Pure."""

from __future__ import annotations

from collections import Counter

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedQueue

MOVES_MAX = 128  # the most moves of channels at the same time
QUEUE_MOVES_MAX = 8  # fewer, because the calls of a queue wait for its copy
OF_ONE_SHARE = 0.75  # the share of the moves that one client may use, so that other clients get some


class MoveSlots:
    """Moves of channels or queues in one direction. `direction` describes it, such as "to host h1"."""

    def __init__(self, direction: str, *, of_queues: bool = False) -> None:
        self._what, self._direction = "queues" if of_queues else "channels", direction
        self._moves_max = QUEUE_MOVES_MAX if of_queues else MOVES_MAX
        self._moves_of_one_max = round(OF_ONE_SHARE * self._moves_max)
        self._creators: Counter[str] = Counter()

    @property
    def under_way(self) -> int:
        """The number of moves under way."""
        return self._creators.total()

    def check(self, record: RecordedChannel | RecordedQueue) -> None:
        """Raises Overloaded if too many channels move now, or too many with the same creator as this channel."""
        if self.under_way >= self._moves_max:
            raise Overloaded(f"{self._moves_max} {self._what} move {self._direction} already; wait until one has moved")
        creator = record.created_by
        if _has_name(creator) and self._creators[creator] >= self._moves_of_one_max:
            raise Overloaded(
                f"{creator} has created {self._moves_of_one_max} of the {self._what} that move {self._direction} "
                "already; wait until one has moved"
            )

    def take(self, record: RecordedChannel | RecordedQueue) -> None:
        """Note that a channel moves. Raises the errors of `check`."""
        self.check(record)
        self._creators[record.created_by] += 1

    def give_back(self, record: RecordedChannel | RecordedQueue) -> None:
        """Note that the move of a channel is over."""
        self._creators[record.created_by] -= 1
        if not self._creators[record.created_by]:
            del self._creators[record.created_by]


def _has_name(creator: str) -> bool:
    """Whether only one caller has this name. Callers that share a secret are `@clients` or `@cluster`."""
    return bool(creator) and not creator.startswith("@")
