"""The metrics of a host's queues, made in pieces."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from heapq import heappush, heappushpop

from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.metrics import catalog
from stampede_rt_channel_host.metrics.catalog import NAMES_MAX
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.queue_totals import GROWING, add_counts
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_runtime.metrics.families import Family

_REJECTED = "rejected_"
_EVENTS = tuple(name for name in GROWING if not name.startswith(_REJECTED) and name != "accepted_bytes")


class QueueMetrics:
    """The metrics of the queues of one host. `shows` returns whether a queue may have metrics of its own."""

    def __init__(self, queues: QueueStore, shows: Callable[[str], object]) -> None:
        self._queues = queues
        self._shows = shows
        self._former: Counter[str] = Counter()

    def families(self) -> Pieces[list[Family]]:
        """All metrics. Each queue is as of the moment at which the host looked at it."""
        counts: Counter[str] = Counter()
        held = leased = 0
        busiest: list[tuple[int, int, HostedQueue]] = []
        for part in self._queues.in_parts():
            for hosted in part:
                add_counts(counts, hosted)
                counted = hosted.queue.latest_counters()
                held, leased = held + counted.held, leased + counted.leased
                self._note(busiest, hosted, counted.accepted + counted.held)
            yield
        counts += self._queues.departed
        counts |= self._former  # a queue that left meanwhile may be lacking
        self._former = counts
        shown = [(display_name(one.record), one) for _, _, one in busiest]
        return [*_sums(counts, held, leased), *_of_each(sorted(shown, key=lambda one: one[0]), self._queues.now())]

    def _note(self, busiest: list[tuple[int, int, HostedQueue]], hosted: HostedQueue, messages: int) -> None:
        if len(busiest) == NAMES_MAX and messages <= busiest[0][0]:
            return
        if self._shows(display_name(hosted.record)):
            push = heappush if len(busiest) < NAMES_MAX else heappushpop
            push(busiest, (messages, hosted.order, hosted))


def _sums(counts: Counter[str], held: int, leased: int) -> Iterator[Family]:
    yield catalog.QUEUE_EVENTS.family(((name,), counts[name]) for name in _EVENTS)
    yield catalog.QUEUE_REJECTED.family(
        ((name.removeprefix(_REJECTED),), counts[name]) for name in GROWING if name.startswith(_REJECTED)
    )
    yield catalog.QUEUE_BYTES.of(counts["accepted_bytes"])
    yield catalog.QUEUE_HELD.of(held)
    yield catalog.QUEUE_LEASED.of(leased)


def _of_each(shown: list[tuple[str, HostedQueue]], now: int) -> Iterator[Family]:
    counted = [(name, one.queue.latest_counters()) for name, one in shown]
    yield catalog.ONE_QUEUE_HELD.family(((name,), one.held) for name, one in counted)
    yield catalog.ONE_QUEUE_LEASED.family(((name,), one.leased) for name, one in counted)
    yield catalog.ONE_QUEUE_DEAD.family(((name,), one.dead_lettered) for name, one in counted)
    yield catalog.ONE_QUEUE_AGE.family(
        ((name,), (now - one.queue.oldest_accepted_at) / 1e9)
        for name, one in shown
        if one.queue.oldest_accepted_at is not None
    )
    yield catalog.ONE_QUEUE_TAKERS.family(((name,), one.queue.waiting_takers) for name, one in shown)
