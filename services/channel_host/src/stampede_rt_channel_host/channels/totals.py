"""The sums of the counters of all channels of a host, channels that have left included."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.channel import Counters

CountKey = tuple[str, str]  # the name of a counter, and its cause; empty if it has no cause


@dataclass(slots=True)
class ChannelTotals:
    """Sums over channels. `counts` only grow. The other fields describe the present channels."""

    counts: Counter[CountKey] = field(default_factory=Counter)
    held_items: int = 0
    held_bytes: int = 0
    subscriptions: int = 0
    waiting_gets: int = 0
    waiting_puts: int = 0

    def add(self, hosted: HostedChannel, counted: Counters) -> None:
        """Add a channel. `counted`: its counters."""
        self.add_counts(hosted, counted)
        self.held_items += counted.held
        self.held_bytes += counted.held_bytes
        self.subscriptions += len(hosted.subscriptions) + len(hosted.group_readers)
        self.waiting_gets += hosted.waiting_gets
        self.waiting_puts += len(hosted.puts)

    def add_counts(self, hosted: HostedChannel, counted: Counters) -> None:
        """Add only the counters of a channel, because it leaves.

        Leaves out items that other hosts count: the items of a copy, and the items of a channel before it moved here.
        """
        self.add_delivered(hosted)
        if hosted.copy is None:
            self.counts.update(dict(_counts_of_items(counted)))
            if hosted.counted_before is not None:
                self.counts.subtract(dict(_counts_of_items(hosted.counted_before)))

    def add_delivered(self, hosted: HostedChannel) -> None:
        """Add the items that were sent to readers of the channel."""
        self.counts.update(dict(_counts_of_readers(hosted)))

    def not_below(self, former: ChannelTotals) -> None:
        """Raise each counter to at least its former value.

        The sums are made in pieces, so they may lack a channel that left meanwhile.
        """
        self.counts |= former.counts


def counts_of(hosted: HostedChannel, counted: Counters) -> Iterator[tuple[CountKey, int]]:
    """The counters of one channel, each with its name and cause. They include the counts of former owners."""
    yield from _counts_of_items(counted)
    yield from _counts_of_readers(hosted)


def _counts_of_items(counted: Counters) -> Iterator[tuple[CountKey, int]]:
    yield ("accepted", ""), counted.accepted
    yield ("accepted_bytes", ""), counted.accepted_bytes
    yield ("late", ""), counted.late
    for cause, count in counted.collected.items():
        yield ("collected", cause), count
    for reason, count in counted.rejected.items():
        yield ("rejected", reason.lower()), count


def _counts_of_readers(hosted: HostedChannel) -> Iterator[tuple[CountKey, int]]:
    yield ("delivered", ""), hosted.delivered_items
    yield ("delivered_bytes", ""), hosted.delivered_bytes
