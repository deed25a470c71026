"""The state of a copy of a channel at this host: its age, and whether it can serve readers."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from stampede_rt.errors import StampedeError
from stampede_rt.values.timeline import format_duration
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.core.group import CutFloor

SERVED_STALENESS_NANOS_MAX = 5_000_000_000
"""A copy that is older than this serves no reader."""
# a subscription that continues here waits this long at most, until the copy has the items that its reader has
REACH_SECONDS_MAX = 2.0


class Freshness(NamedTuple):
    """The demands of a read on a copy: the greatest age of its state, and a seq that it must have. None: no demand."""

    max_staleness_nanos: int | None = None
    least_seq: int | None = None


class Inheritance(NamedTuple):
    """The copy has all items of its source, and the source no longer changes.

    `host_time`: the channel's clock there.
    """

    host_time: int


class CopyState:
    """The state of a copy, which its feed keeps up to date.

    `as_of_nanos`: the copy has all items that the owner had at this moment of the steady clock; None: it has nothing
    yet. `caught_up`: the copy has had all items of its source at some moment. `source_next_seq`: as the source last
    reported it.
    """

    def __init__(
        self, on_dropped: Callable[[], None] = lambda: None, steady_nanos: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """`on_dropped` is called once, when the host drops the copy."""
        self.on_dropped = on_dropped
        self._steady_nanos = steady_nanos
        self.source_host_id = b""
        self.source_next_seq = 0
        self.as_of_nanos: int | None = None
        self.caught_up = False
        self.is_replica = False  # a replica has items that readers must not see yet, so it serves no reader
        self.reconnects = 0
        self.moves_here = False  # a move feeds the copy, so that this host becomes the owner
        self.may_inherit: Inheritance | None = None  # set if the host may become the owner, with this copy's items
        self.floors: dict[bytes, CutFloor] = {}  # by group: the cut up to which the copy may show the group
        self._changed = asyncio.Event()

    def steady_nanos(self) -> int:
        """The steady clock of this host."""
        return self._steady_nanos()

    @property
    def staleness_nanos(self) -> int:
        """How old the copy is at most."""
        return SERVED_STALENESS_NANOS_MAX * 2 if self.as_of_nanos is None else self._steady_nanos() - self.as_of_nanos

    @property
    def is_ready(self) -> bool:
        """Whether the copy can serve readers."""
        return self.caught_up and not self.is_replica and self.staleness_nanos <= SERVED_STALENESS_NANOS_MAX

    def merge_floors(self, floors: Iterable[CutFloor]) -> None:
        """Process the cuts of groups that the source has reported.

        A cut moves back only if its group has begun anew.
        """
        for floor in floors:
            known = self.floors.get(floor.group_id)
            if known is None or known.incarnation != floor.incarnation or known.cut <= floor.cut:
                self.floors[floor.group_id] = floor

    async def wait_for(self, condition: Callable[[], bool], seconds_max: float) -> bool:
        """Wait until `condition` holds after a part of the feed, `seconds_max` at most. Returns whether it holds."""
        await self._wait(condition, seconds_max)
        return condition()

    def note_progress(self) -> None:
        """Wake the callers that wait for the copy."""
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()

    def check(self, name: str, next_seq: int, demand: Freshness) -> None:
        """Raises StaleBinding (MOVED) if the copy of channel `name` does not meet the demand. Its seqs are below
        `next_seq`.
        """
        if self.is_replica:
            raise refusals.copy_cannot(name, "is a replica, which serves no caller before it becomes the owner")
        if not self.is_ready:
            raise refusals.copy_cannot(name, "has lost its source, or has not caught up with it yet")
        stale, least = demand.max_staleness_nanos, demand.least_seq
        if stale is not None and self.staleness_nanos > stale:
            age, most = format_duration(self.staleness_nanos), format_duration(stale)
            raise refusals.copy_cannot(name, f"may be {age} old, and the read accepts {most}")
        if least is not None and least >= next_seq:
            raise refusals.copy_cannot(name, f"has items up to seq {next_seq - 1}, and the read wants seq {least}")

    async def reach(self, name: str, next_seq: Callable[[], int], wanted: int) -> None:
        """Wait until `next_seq()` is at least `wanted` and the copy is ready, at most REACH_SECONDS_MAX.

        Raises StaleBinding (MOVED) if the wait is over.
        """
        await self._wait(lambda: next_seq() >= wanted and self.is_ready, REACH_SECONDS_MAX)
        self.check(name, next_seq(), Freshness(least_seq=wanted - 1))

    async def ready(self, name: str, seconds_max: float) -> None:
        """Wait until the copy can serve readers. Raises StaleBinding (MOVED) after `seconds_max`."""
        await self._wait(lambda: self.is_ready or self.is_replica, seconds_max)
        self.check(name, 0, Freshness())

    async def _wait(self, condition: Callable[[], bool], seconds_max: float) -> None:
        try:
            async with asyncio.timeout(seconds_max):
                while not condition():
                    await self._changed.wait()
        except TimeoutError:
            return


def gone(name: str) -> StampedeError:
    """The error for the readers of a copy that the host drops."""
    return refusals.copy_cannot(name, "is removed")
