"""The copies of one channel that this host feeds, and the readers that it sends to them.

Each copy reports the number of its readers on its feed. The host sends a new reader to the copy with the fewest
readers, if that copy has fewer readers than the host itself. If a copy is added while readers are connected, the host
sends some of them there, a few at a time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.observers import Observers

REPORT_AGE_NANOS_MAX = 3_000_000_000  # a copy that is silent for longer gets no readers
READERS_MOVED_MAX = 16  # the most readers that move at each report of a copy, about twice a second
BALANCED_SHARE = 8
"""The host sends connected readers to a copy only if the host has at least two readers more than the copy. The
difference must also be more than an eighth of the readers that each would have if all had the same number."""


class FedCopy:
    """One copy that this host feeds. `waiting` returns the number of items that the host has still to send to it."""

    def __init__(self, host_id: bytes, target: str, waiting: Callable[[], int], *, is_replica: bool = False) -> None:
        self.host_id = host_id
        self.target = target
        self.waiting = waiting
        self.is_replica = is_replica
        self.subscriptions = 0  # as last reported, plus the readers that the host has sent there since
        self.ready = False
        self.reported_nanos = time.monotonic_ns()

    def report(self, subscriptions: int, *, ready: bool) -> None:
        """Note a report of the copy."""
        self.subscriptions, self.ready, self.reported_nanos = subscriptions, ready, time.monotonic_ns()

    @property
    def report_age_nanos(self) -> int:
        """The time since the last report."""
        return time.monotonic_ns() - self.reported_nanos

    @property
    def takes_readers(self) -> bool:
        """Whether the copy can serve readers, as far as this host knows."""
        return self.ready and self.report_age_nanos <= REPORT_AGE_NANOS_MAX


class FedCopies:
    """The copies of one channel that this host feeds."""

    def __init__(self) -> None:
        self._copies: dict[FedCopy, None] = {}
        self._turn = 0

    def __iter__(self) -> Iterator[FedCopy]:
        return iter(self._copies)

    def __bool__(self) -> bool:
        return bool(self._copies)

    def add(self, copy: FedCopy) -> None:
        """Add a copy."""
        self._copies[copy] = None

    def discard(self, copy: FedCopy) -> None:
        """Forget a copy. Idempotent."""
        self._copies.pop(copy, None)

    def less_loaded(self, name: str, own: int) -> StampedeError | None:
        """The error that sends a new reader of channel `name` to a copy; None if the host should serve the reader
        itself.

        `own`: the number of readers at the host.
        """
        copy = min(self._serving(), key=lambda one: one.subscriptions, default=None)
        if copy is None or copy.subscriptions >= own:
            return None
        return _redirect_to(name, copy)

    def for_gets(self) -> str:
        """The gatekeeper of a copy for a reader's gets: another copy at each call; empty if no copy can serve."""
        serving = self._serving()
        self._turn += 1
        return serving[self._turn % len(serving)].target if serving else ""

    def relieve(self, name: str, copy: FedCopy, readers: Observers) -> None:
        """Send some of the readers of this host to `copy`, if the host has more than its share of them."""
        if not copy.takes_readers or copy not in self._copies:
            return
        serving, own = self._serving(), len(readers)
        share = (own + sum(one.subscriptions for one in serving)) // (len(serving) + 1)
        is_balanced = own - copy.subscriptions <= max(1, share // BALANCED_SHARE)
        wanted = 0 if is_balanced else min(own - share, share - copy.subscriptions, READERS_MOVED_MAX)
        for reader in readers:
            if wanted <= 0:
                return
            if reader.may_move:
                reader.end(_redirect_to(name, copy))
                wanted -= 1

    def _serving(self) -> list[FedCopy]:
        return [one for one in self._copies if one.takes_readers]


def _redirect_to(name: str, copy: FedCopy) -> StampedeError:
    copy.subscriptions += 1  # counts until the next report of the copy
    return refusals.to_copy(name, copy.host_id, copy.target)
