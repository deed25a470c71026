"""Rings in shared memory for these tests. Readers use the host's steered clock, and open rings again without pauses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, Protocol
from unittest import mock

from stampede_rt._async import ring_following, ring_reads, shared_rings, subscription
from stampede_rt._sync import ring_following as blocking_following
from stampede_rt._sync import ring_reads as blocking_reads
from stampede_rt._sync import shared_rings as blocking_rings
from stampede_rt._sync import subscription as blocking_subscription
from stampede_rt.ring import facts
from stampede_rt.transports import ring_mapping


class BootClock(Protocol):
    """A host whose clocks move only by `tick`."""

    @property
    def boot_nanos(self) -> int:
        """The host's reading of CLOCK_BOOTTIME."""


class _SteeredTime:
    """Replaces the module `time` for readers of rings, which read CLOCK_BOOTTIME there."""

    def __init__(self, host: BootClock) -> None:
        self._host = host

    def clock_gettime_ns(self, _: int) -> int:
        return self._host.boot_nanos


@contextmanager
def steered_rings(host: BootClock) -> Iterator[Counter[str]]:
    """Yield the numbers of answers that came from rings, by kind."""
    answers: Counter[str] = Counter()

    def counted(kind: str, make: Callable[..., Any]) -> Callable[..., Any]:
        def make_and_count(*arguments: Any, **named: Any) -> Any:
            answers[kind] += 1
            return make(*arguments, **named)

        return make_and_count

    with ExitStack() as patches:

        def patch(target: Any, name: str, value: Any) -> None:
            patches.enter_context(mock.patch.object(target, name, value))

        patch(ring_mapping, "time", _SteeredTime(host))
        patch(facts, "AGE_MARGIN_NANOS", 0)
        for rings in (shared_rings, blocking_rings):
            patch(rings, "RETRY_PAUSE_S", 0.0)
        for subscriptions in (subscription, blocking_subscription):
            patch(subscriptions, "NO_RING_S", 0.0)
        for reads in (ring_reads, blocking_reads):
            patch(reads, "_answer", counted("get", reads._answer))
            patch(reads, "newest_item", counted("newest", reads.newest_item))
        for following in (ring_following, blocking_following):
            patch(following, "items_of", counted("subscription", following.items_of))
        yield answers


def follows_ring(subscription: Any) -> bool:
    """Whether the items of a subscription come from a ring, so that the host does not count it."""
    return getattr(subscription, "_follower", None) is not None
