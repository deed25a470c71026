"""The moves that a host may have under way, and each maker's share of them. Pure."""

from __future__ import annotations

from collections import Counter

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedQueue

MOVES_MAX = 8
MOVES_OF_ONE_MAX = 6  # fewer than MOVES_MAX, so that one client leaves some moves for others


class MoveSlots:
    """Moves in one direction. `direction` describes it, such as "to host h1", and `what` the things that move."""

    def __init__(self, direction: str, what: str = "channels") -> None:
        self._what, self._direction = what, direction
        self._makers: Counter[str] = Counter()

    def check(self, record: RecordedChannel | RecordedQueue) -> None:
        """Raises Overloaded if too many channels move now, or too many channels that this maker has made."""
        if self._makers.total() >= MOVES_MAX:
            raise Overloaded(f"{MOVES_MAX} {self._what} move {self._direction} already; wait for one")
        maker = record.created_by
        if _has_name(maker) and self._makers[maker] >= MOVES_OF_ONE_MAX:
            raise Overloaded(
                f"{MOVES_OF_ONE_MAX} {self._what} that {maker} has made move {self._direction} already; wait for one"
            )

    def take(self, record: RecordedChannel | RecordedQueue) -> None:
        """Note that a channel moves. Raises the errors of `check`."""
        self.check(record)
        self._makers[record.created_by] += 1

    def give_back(self, record: RecordedChannel | RecordedQueue) -> None:
        """Note that the move of a channel is over."""
        self._makers[record.created_by] -= 1
        if not self._makers[record.created_by]:
            del self._makers[record.created_by]


def _has_name(maker: str) -> bool:
    """Whether one caller alone has this name. Callers that share a secret are `@clients` or `@cluster`."""
    return bool(maker) and not maker.startswith("@")
