"""The metrics of a host's channels. They are made in pieces: a host may have a hundred thousand channels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from heapq import heappush, heappushpop

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.channels.totals import ChannelTotals, counts_of
from stampede_rt_channel_host.core.channel import COLLECTED_FOR, REASONS, Pieces
from stampede_rt_channel_host.metrics import catalog
from stampede_rt_channel_host.metrics.catalog import NAMES_MAX
from stampede_rt_runtime.metrics.families import Family

CHANNELS_PER_PIECE = 64
"""It takes up to 10 us to add one channel."""


class ChannelMetrics:
    """The metrics of the channels of one host. `shows` returns whether a channel may have metrics of its own."""

    def __init__(self, store: ChannelStore, shows: Callable[[str], object]) -> None:
        self._store = store
        self._shows = shows
        self._former = ChannelTotals()

    def families(self) -> Pieces[list[Family]]:
        """All metrics. Each channel is as of the moment at which the host looked at it."""
        totals = ChannelTotals()
        busiest: list[tuple[int, int, HostedChannel]] = []
        after = ""
        while found := self._store.named_after(after, CHANNELS_PER_PIECE):
            for hosted in found:
                counted = hosted.core.latest_counters()
                totals.add(hosted, counted)
                self._note(busiest, hosted, counted.accepted_bytes + hosted.delivered_bytes)
            after = found[-1].record.name
            yield
        totals.counts += self._store.departed.counts
        totals.not_below(self._former)
        self._former = totals
        shown = sorted((hosted for _, _, hosted in busiest), key=lambda hosted: hosted.record.name)
        now = self._store.now()
        return [*_sums(totals), *_of_readers(self._store.readers), *_of_each(shown, now)]

    def _note(self, busiest: list[tuple[int, int, HostedChannel]], hosted: HostedChannel, moved: int) -> None:
        """Keep the channel if it is among the busiest that are shown: the channels with the most bytes in and out."""
        if len(busiest) == NAMES_MAX and moved <= busiest[0][0]:
            return
        if self._shows(hosted.record.name):
            push = heappush if len(busiest) < NAMES_MAX else heappushpop
            push(busiest, (moved, hosted.order, hosted))


def _sums(totals: ChannelTotals) -> Iterator[Family]:
    counts = totals.counts
    yield catalog.ITEMS_ACCEPTED.of(counts["accepted", ""])
    yield catalog.ITEMS_ACCEPTED_BYTES.of(counts["accepted_bytes", ""])
    yield catalog.ITEMS_DELIVERED.of(counts["delivered", ""])
    yield catalog.ITEMS_DELIVERED_BYTES.of(counts["delivered_bytes", ""])
    yield catalog.ITEMS_LATE.of(counts["late", ""])
    yield catalog.ITEMS_COLLECTED.family(((one,), counts["collected", one]) for one in COLLECTED_FOR)
    yield catalog.ITEMS_REJECTED.family(((one.lower(),), counts["rejected", one.lower()]) for one in REASONS)
    yield catalog.ITEMS_HELD.of(totals.held_items)
    yield catalog.ITEMS_HELD_BYTES.of(totals.held_bytes)
    yield catalog.SUBSCRIPTIONS.of(totals.subscriptions)
    yield catalog.GETS_WAITING.of(totals.waiting_gets)
    yield catalog.PUTS_WAITING.of(totals.waiting_puts)


def _by_cause(counts: Iterable[tuple[tuple[str, str], int]], wanted: str) -> Iterator[tuple[tuple[str, ...], float]]:
    return (((cause,), count) for (name, cause), count in sorted(counts) if name == wanted)


def _of_readers(readers: Readers) -> Iterator[Family]:
    collected, skipped = readers.sums()
    yield catalog.ITEMS_DROPPED.family([(("collected",), collected), (("skipped",), skipped)])
    yield catalog.SUBSCRIPTION_DROPPED.family(
        ((one.source, one.subscriber, cause), count)
        for one in readers.worst(NAMES_MAX)
        for cause, count in (("collected", one.collected), ("skipped", one.skipped))
        if count
    )


def _of_each(shown: list[HostedChannel], now: int) -> Iterator[Family]:
    """The metrics of single channels."""
    counted_by_name = [(hosted.record.name, hosted.core.latest_counters()) for hosted in shown]
    counts = {
        name: dict(counts_of(hosted, counted)) for hosted, (name, counted) in zip(shown, counted_by_name, strict=True)
    }
    for metric, counted in (
        (catalog.CHANNEL_ACCEPTED, "accepted"),
        (catalog.CHANNEL_ACCEPTED_BYTES, "accepted_bytes"),
        (catalog.CHANNEL_DELIVERED_BYTES, "delivered_bytes"),
        (catalog.CHANNEL_LATE, "late"),
    ):
        yield metric.family(((name,), one[counted, ""]) for name, one in counts.items())
    for metric, counted in ((catalog.CHANNEL_COLLECTED, "collected"), (catalog.CHANNEL_REJECTED, "rejected")):
        yield metric.family(
            ((name, *cause), count)
            for name, one in counts.items()
            for cause, count in _by_cause(one.items(), counted)
            if count
        )
    yield catalog.CHANNEL_HELD.family(((name,), one.held) for name, one in counted_by_name)
    yield catalog.CHANNEL_HELD_BYTES.family(((name,), one.held_bytes) for name, one in counted_by_name)
    yield catalog.CHANNEL_NEWEST_AGE.family(
        ((hosted.record.name,), (now - hosted.channel.newest) / 1e9)
        for hosted in shown
        if hosted.channel.newest is not None
    )
    yield catalog.CHANNEL_SUBSCRIPTIONS.family(
        ((hosted.record.name,), len(hosted.subscriptions) + len(hosted.group_readers)) for hosted in shown
    )
