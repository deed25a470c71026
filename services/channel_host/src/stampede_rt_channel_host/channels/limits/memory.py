"""The memory budget that all channels and queues of a host share, and a count of the refusals for lack of memory."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.limits.consumption_shares import ConsumptionShares
from stampede_rt_channel_host.channels.limits.request_room import RequestRooms
from stampede_rt_runtime.overload import OverloadCounter
from stampede_rt_runtime.quotas.accounts import Account, Accounts, unlimited
from stampede_rt_runtime.quotas.limits import Quota

logger = logging.getLogger(__name__)

CONSUMPTION_SHARE = 16
"""Consumption may use 1/16 of the budget in addition to the budget. One caller may use half of this memory."""

RECLAIMS_MAX = 6
"""The most steps of `reclaim` for one claim. All of them take a few milliseconds, whatever is due."""


class MemoryBudget:
    """The memory of all channels and queues together.

    Each channel and queue reports its memory when its memory changes, and the budget adds the reports up. So a claim
    costs the same, however many channels and queues there are. Before the budget refuses a claim, it calls `reclaim`
    RECLAIMS_MAX times at most. Each call frees some outdated items, and returns whether there may be more. `requests`
    is the memory for requests that are not yet complete. It does not count towards `bytes_max`.
    """

    def __init__(
        self,
        bytes_max: int,
        reclaim: Callable[[], bool] = lambda: False,
        steady_nanos: Callable[[], int] = time.monotonic_ns,
        accounts: Accounts | None = None,
    ) -> None:
        """`accounts`: the accounts of the callers that create channels and queues; None: bytes count for no caller."""
        self._accounts = accounts
        self.used_bytes = 0
        self.bytes_max = bytes_max
        self.overload = OverloadCounter()
        self.refused_for_archive = False
        """Whether the limit of the archive's disk, and not of the memory, refused the last items."""
        self.requests = RequestRooms()
        self.consumption_shares = ConsumptionShares(bytes_max // (2 * CONSUMPTION_SHARE))
        self._reclaim = reclaim
        self._steady_nanos = steady_nanos

    def claim(self, wanted_bytes: int) -> None:
        """Check that there is room to store `wanted_bytes`.

        Raises Overloaded if not. Reserves nothing: the owner reports the bytes after it has stored them (`Charge.set`).
        """
        if self.used_bytes + wanted_bytes <= self.bytes_max:
            return
        for _ in range(RECLAIMS_MAX):
            if not self._reclaim() or self.used_bytes + wanted_bytes <= self.bytes_max:
                break
        if self.used_bytes + wanted_bytes > self.bytes_max:
            raise Overloaded(
                f"the host's channels and queues hold {self.used_bytes} bytes together, of at most {self.bytes_max} "
                "(--memory-bytes-max, or max_memory of st.host); put again later, tighten retention, or use "
                "another host",
                metadata={"memory_bytes_max": str(self.bytes_max)},
            )

    def charge_for(self, created_by: str) -> Charge:
        """The charge of a channel or queue that the caller `created_by` has created."""
        return Charge(self, None if self._accounts is None else self._accounts.of(created_by))

    def refused(self, name: str, items: int, error: Overloaded) -> None:
        """Count items that were refused for the channel or queue `name`.

        Writes a log line every few seconds at most.
        """
        self.refused_for_archive = "archive_bytes_max" in error.metadata
        unreported = self.overload.note(items, self._steady_nanos())
        if unreported is not None:
            logger.warning(
                "puts are refused",
                extra={"event": "puts_refused", "items": unreported, "last_for": name, "why": error.message},
            )

    def refused_ago_nanos(self) -> int | None:
        """The time since the last refusal, in nanoseconds; None: there was no refusal."""
        return self.overload.ago_nanos(self._steady_nanos())


class Charge:
    """The memory that the budget counts for one channel or queue, and for the caller that created it."""

    __slots__ = ("_account", "_budget", "_bytes", "_held")

    def __init__(self, budget: MemoryBudget, account: Account | None = None) -> None:
        """`account`: the account of the creator; None: the bytes count for no caller."""
        self._budget = budget
        self._account = account or unlimited()
        self._held = self._account.charge_for(Quota.BYTES_HELD)
        self._bytes = 0

    @property
    def consumption_shares(self) -> ConsumptionShares:
        """The memory for each caller's consumption at the host."""
        return self._budget.consumption_shares

    @property
    def spare_bytes(self) -> int:
        """The bytes beyond the limit that only consumption may use."""
        return self._budget.bytes_max // CONSUMPTION_SHARE

    def has_room(self, wanted_bytes: int) -> bool:
        """Whether there is room for `wanted_bytes` at present. Unlike `claim`, does not free outdated items first."""
        within = self._budget.used_bytes + wanted_bytes <= self._budget.bytes_max
        return within and self._account.has_room(Quota.BYTES_HELD, wanted_bytes)

    def claim(self, wanted_bytes: int) -> None:
        """Check that there is room to store `wanted_bytes`. Raises Overloaded if not.

        Reserves nothing: the owner reports the bytes with `set` after it has stored them.
        """
        self._budget.claim(wanted_bytes)
        self._account.check(Quota.BYTES_HELD, wanted_bytes)

    def refused(self, name: str, items: int, error: Overloaded) -> None:
        """Count items that were refused for the channel or queue, see `MemoryBudget`."""
        self._budget.refused(name, items, error)

    def set(self, footprint_bytes: int) -> None:
        """Report the bytes kept now."""
        self._budget.used_bytes += footprint_bytes - self._bytes
        self._bytes = footprint_bytes
        self._held.set(footprint_bytes)


def own_bytes(run: bytes | memoryview) -> bytes | memoryview:
    """The run, copied if it is a view of a request that is much larger than the run.

    So a run that is kept does not keep much more than its own bytes in memory. A view of nearly the whole request stays
    as it is, because a copy of 15 MiB takes several milliseconds.
    """
    if isinstance(run, memoryview) and len(run) < len(run.obj) * 7 // 8:  # type: ignore[arg-type]
        return bytes(run)
    return run
