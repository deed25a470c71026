"""All metrics of one channel host, besides the metrics that every service has."""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt.values.peering import ClockOffset
from stampede_rt_channel_host.archive.objects.segment_mover import MovedCounts
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.lease_thread import LeaseThread
from stampede_rt_channel_host.groups.store import GroupStore
from stampede_rt_channel_host.metrics import catalog
from stampede_rt_channel_host.metrics.channel_metrics import ChannelMetrics
from stampede_rt_channel_host.metrics.group_metrics import GroupMetrics
from stampede_rt_channel_host.metrics.queue_metrics import QueueMetrics
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_runtime.globs import matcher
from stampede_rt_runtime.metrics.families import AnyFamily, Family
from stampede_rt_runtime.metrics.service_metrics import of_clocks

LEADER = "leader"


class HostMetrics:
    """The metrics of one host. `names`: the pattern of the channels, queues and groups with metrics of their own.

    An empty pattern gives no such metrics.
    """

    def __init__(
        self, store: ChannelStore, queues: QueueStore, groups: GroupStore, lease: LeaseThread, *, names: str
    ) -> None:
        shows = matcher(names) if names else _no_name
        self._store, self._queues, self._lease = store, queues, lease
        self._channels = ChannelMetrics(store, shows)
        self._queue_metrics = QueueMetrics(queues, shows)
        self._groups = GroupMetrics(groups, shows)

    async def collect(self) -> list[AnyFamily]:
        """All metrics, made in pieces of about a millisecond."""
        families: list[AnyFamily] = [*self._of_host()]
        for metrics in (self._channels, self._queue_metrics, self._groups):
            families += await self._store.scheduler.do(metrics.families())
        return families

    def _of_host(self) -> Iterator[Family]:
        memory = self._store.memory
        yield catalog.LEASE_HELD.of(self._lease.lease_held())
        yield catalog.LEASE_REMAINING.of(self._lease.fenced_in_nanos() / 1e9)
        yield catalog.MEMORY_HELD.of(memory.used_bytes)
        yield catalog.MEMORY_LIMIT.of(memory.bytes_max)
        yield catalog.CHANNELS.of(self._store.count)
        yield catalog.QUEUES.of(self._queues.count)
        yield from self._of_archive()
        yield from self._of_multicast()
        clock: ClockOffset | None = self._lease.clock()
        yield from of_clocks({} if clock is None else {LEADER: clock})

    def _of_multicast(self) -> Iterator[Family]:
        multicasts = self._store.multicasts
        if multicasts is None:
            return
        group = multicasts.group
        yield catalog.MULTICAST_CHANNELS.of(len(multicasts))
        yield catalog.MULTICAST_READERS.of(multicasts.readers)
        yield catalog.MULTICAST_DATAGRAMS.of(group.datagrams)
        yield catalog.MULTICAST_BYTES.of(group.bytes)
        yield catalog.MULTICAST_UNSENT.of(group.unsent)
        yield catalog.MULTICAST_REPAIRS.of(multicasts.repairs)

    def _of_archive(self) -> Iterator[Family]:
        archive, counts = self._store.recordings.archive, self._store.recordings.counts()
        yield catalog.ITEMS_UNARCHIVED.of(counts.unarchived)
        yield catalog.ARCHIVE_BACKLOG.of(counts.backlog_items)
        if archive is not None:
            yield catalog.ARCHIVE_BYTES.of(archive.disk.used_bytes)
            yield catalog.ARCHIVE_LIMIT.of(archive.disk.bytes_max)
        yield catalog.ARCHIVE_FAILING.of(archive is not None and bool(archive.failure))
        yield catalog.ARCHIVE_DAMAGED.of(counts.damaged_blocks)
        if archive is not None and archive.objects is not None:
            yield from _of_store(archive.objects.mover.counts())


def _no_name(name: str) -> bool:
    return False


def _of_store(counts: MovedCounts) -> Iterator[Family]:
    yield catalog.STORE_OBJECTS.of(counts.objects)
    yield catalog.STORE_BYTES.of(counts.bytes)
    yield catalog.STORE_WAITING.of(counts.waiting_bytes)
    yield catalog.STORE_MOVED.of(counts.moved_bytes)
    yield catalog.STORE_FETCHED.of(counts.fetched_bytes)
    yield catalog.STORE_FAILURES.of(counts.failures)
    yield catalog.STORE_CACHE.of(counts.cache_bytes)
