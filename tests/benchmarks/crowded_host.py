"""The CPU cost of one put for a host with many other channels and calls.

    python -m tests.benchmarks.crowded_host [--runs 5]

The rows differ in the things beside the put: blocked gets that the put cannot release, idle channels, or consumers of
the channel. The benchmark calls the host's channels directly, as the host's streams call them, without gRPC.

The last row is about a cluster of processes: the time in which a client opens a new channel and puts its first item, if
many channels are open already.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import statistics
import time
from collections.abc import Callable, Sequence

from stampede_rt.errors import Overloaded
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_bench.clusters import connected
from stampede_rt_bench.tables import Table
from stampede_rt_channel_host.channels.gets.get_release import SourceSnapshot
from stampede_rt_channel_host.channels.gets.waiting_gets import WaitingGets
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.sweep import Sweep
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import Position, Query, ReachTracker, WakeAt
from stampede_rt_channel_host.core.group import Horizon, VisibleChannel

COUNTS = (10, 100, 1000, 10_000)
CONSUMERS_MAX = 1000  # one channel may have 1024 at most
PUTS = 200
S = 10**9
START = 1_700_000_000 * S
NOW = START + 100_000 * S


class Host:
    """Channels under one clock, one budget and one sweep."""

    def __init__(self) -> None:
        self.now = NOW
        self.sweep = Sweep(lambda: self.now)
        self.memory = MemoryBudget(2**40, self.sweep.reclaim)

    def open(self, **policy: int | None) -> HostedChannel:
        record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(Policy(**policy)))
        return HostedChannel(recorded_channel(record), self.memory, lambda: self.now, self.sweep.touch)

    def put(self, channel: HostedChannel, at: int) -> None:
        encoded = encode_run([b"x" * 64], times=[at], durations=[S])
        channel.puts.put(IncomingRun(encoded, producer_id=0, first_number=0, wait_nanos=None), self.now)


class GroupedSource:
    """A channel as a group shows it: a `Source` whose cut does not move."""

    def __init__(self, channel: HostedChannel, cut: int) -> None:
        self.horizon = Horizon(cut, str)
        self.view = VisibleChannel(channel.channel)
        self.polling = lambda pending, now: self.view.polling(pending, self.horizon, now)
        self.giving_up = lambda pending, now: self.view.giving_up(pending, self.horizon, now)

    def moment(self, now: int) -> SourceSnapshot:
        raise AssertionError("no get was to be released")


class _Follower:
    def __init__(self, gets: WaitingGets, host: Host) -> None:
        self._gets, self._host = gets, host

    def wake(self) -> None:
        self._gets.changed(self._host.now)

    def end(self, error: object) -> None:
        pass


def ignore(outcome: object) -> None:
    raise AssertionError(f"no get was to be released, but one was: {outcome}")


def puts_beside_group_gets(others: int) -> list[float]:
    """Gets of the next item, through a group that another member holds back."""
    host = Host()
    channel = host.open(max_items=100)
    host.put(channel, START)
    shown = GroupedSource(channel, START + 1)
    gets = WaitingGets(shown, ReachTracker(channel.channel), lambda: host.now, lambda: START + 1)
    channel.group_observers[_Follower(gets, host)] = None
    query = Query(
        interval=parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, newer_than=Position(START), limit=1
    )
    for _ in range(others):
        pending = shown.view.begin(query, shown.horizon, host.now)
        wake = shown.view.poll(pending, shown.horizon, host.now)
        assert isinstance(wake, WakeAt)
        gets.add(pending, wake, -1, host.now, ignore)
    return timed(lambda at: host.put(channel, START + S * (at + 1)))


def puts_beside_gets_ahead(others: int) -> list[float]:
    """A replay: gets of items between the newest item and the clock."""
    host = Host()
    channel = host.open(max_items=100)
    host.put(channel, START)
    for place in range(others):
        begin = START + (2 * PUTS + place) * S
        pending = channel.channel.begin(Query(interval=parse_interval(begin, begin + S)), host.now)
        wake = channel.channel.poll(pending, host.now)
        assert isinstance(wake, WakeAt)
        channel.gets.add(pending, wake, -1, host.now, ignore)
    return timed(lambda at: host.put(channel, START + S * (at + 1)))


def puts_beside_consumers(others: int) -> list[float]:
    """All consumers have consumed the earlier items, and must still consume this item."""
    host, channel = with_consumers(others)
    return timed(lambda at: host.put(channel, START + at))


def consumes_beside_consumers(others: int) -> list[float]:
    """One consumer consumes an item that the others have consumed."""
    host, channel = with_consumers(others)
    for at in range(PUTS):
        host.put(channel, START + at)
    seqs = range(1, PUTS + 1)
    for consumer in range(2, others + 1):
        channel.channel.consume(consumer, seqs, host.now)
    return timed(lambda at: channel.channel.consume(1, [at + 1], host.now))


def with_consumers(others: int) -> tuple[Host, HostedChannel]:
    host = Host()
    channel = host.open(consumers=others)
    for consumer in range(1, others + 1):
        channel.channel.consume(consumer, [], host.now)
    return host, channel


def with_idle_channels(others: int) -> tuple[Host, HostedChannel]:
    host = Host()
    channels = [host.open(max_age_nanos=10 * S) for _ in range(others)]
    for channel in channels:
        host.put(channel, NOW)
    asyncio.run(host.sweep.sweep())
    host.now += 3600 * S
    return host, channels[0]


def sweeps_of_idle_channels(others: int) -> list[float]:
    """One round of the sweep, after a put into one of the channels."""
    host, channel = with_idle_channels(others)

    async def measured() -> list[float]:
        took = []
        for at in range(PUTS):
            host.put(channel, NOW + at + 1)
            began = time.process_time_ns()
            await host.sweep.sweep()
            took.append((time.process_time_ns() - began) / 1e3)
        return took

    return asyncio.run(measured())


def refusals_for_memory(others: int) -> list[float]:
    """A claim beyond the bound. Before the refusal, the host frees all due items."""
    host, _ = with_idle_channels(others)

    def claim(_: int) -> None:
        with contextlib.suppress(Overloaded):
            host.memory.claim(2**41)

    return timed(claim)


def opens_beside_channels(others: int) -> list[float]:
    """The wall time over gRPC, with the directory's log, the gatekeeper and the put."""
    with connected() as rt:
        for number in range(others):
            rt.channel(f"others/{number}")

        def step(number: int) -> None:
            rt.channel(f"new/{number}").put(b"x" * 64)

        step(PUTS)
        return timed(step, time.perf_counter)


def timed(step: Callable[[int], object], clock_s: Callable[[], float] = time.process_time) -> list[float]:
    """The microseconds that each step took, by the clock of CPU time or by another clock."""
    took = []
    for at in range(PUTS):
        began_s = clock_s()
        step(at)
        took.append((clock_s() - began_s) * 1e6)
    return took


ROWS: Sequence[tuple[str, Callable[[int], list[float]], int]] = (
    ("a put, gets blocked through a group", puts_beside_group_gets, 10_000),
    ("a put, gets between newest and clock", puts_beside_gets_ahead, 10_000),
    ("a sweep, idle channels", sweeps_of_idle_channels, 10_000),
    ("a refusal for memory, idle channels", refusals_for_memory, 10_000),
    ("a put, consumers", puts_beside_consumers, CONSUMERS_MAX),
    ("a consume, consumers", consumes_beside_consumers, CONSUMERS_MAX),
    ("open and first put, wall time", opens_beside_channels, 10_000),
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5, help="the number of measurements of each figure (default: 5)")
    runs: int = parser.parse_args().runs
    table = Table(["us of CPU", *(f"{count:,} others" for count in COUNTS)])
    for name, measure, most in ROWS:
        cells = []
        for count in COUNTS:
            taken = [statistics.median(measure(count)) for _ in range(runs if count <= most else 0)]
            cells.append(f"{statistics.median(taken):,.0f}" if taken else "")
        table.rows.append([name, *cells])
    table.notes.append(f"Medians of {PUTS} steps, of {runs} runs. A channel has {CONSUMERS_MAX} consumers at the most.")
    table.print()


if __name__ == "__main__":
    main()
