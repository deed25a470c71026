"""Channels of a host in this process. They do a host's own work for puts and gets; gRPC is not part of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match, parse_interval
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_bench.measuring import NANOS_PER_US, Spread, quiet
from stampede_rt_channel_host.channels.frames import SharedDeliveries, get_responses
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.sweep import Sweep
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import Query

BYTES_MAX = 2**40
NEWEST = Query(interval=parse_interval(MIN_INSTANT, MAX_INSTANT), match=Match.START, newest_first=True, limit=1)


class OwnChannels:
    """Channels under one clock, one memory budget and one sweep, as a host has them."""

    def __init__(self) -> None:
        self.scheduler = PieceScheduler()
        self._sweep = Sweep(time.time_ns)
        self._memory = MemoryBudget(BYTES_MAX, self._sweep.reclaim)
        self._deliveries = SharedDeliveries()
        self._opened = 0

    def open(self, policy: Policy) -> HostedChannel:
        """A new channel."""
        self._opened += 1
        name, spec = f"bench/{self._opened}", policy_to_spec(policy)
        record = channel_pb2.ChannelRecord(name=name, epoch=1, incarnation=self._opened, spec=spec)
        return HostedChannel(
            recorded_channel(record), self._memory, time.time_ns, self._sweep.touch, begin=self.scheduler.begin,
            deliveries=self._deliveries,
        )  # fmt: skip

    async def sweep(self) -> None:
        """Look at all channels that are due, as a host does twice a second."""
        await self._sweep.sweep()


def put(channel: HostedChannel, encoded: bytes) -> None:
    """Put one encoded run, as a host does after it has received the run."""
    channel.puts.put(IncomingRun(encoded, producer_id=0, first_number=0, wait_nanos=None), time.time_ns())


def get(channel: HostedChannel, query: Query = NEWEST) -> int:
    """Read, and encode the answer. Returns its bytes."""
    answer = channel.channel.read(query, time.time_ns())
    return sum(len(one.encoded) for one in get_responses(1, answer, pb.GetSummary(), without_payloads=False))


def run_of(payload_bytes: int) -> bytes:
    """An encoded run of one item without a time."""
    return encode_run([bytes(payload_bytes)], times=None)


def cpu_us(operation: Callable[[int], object], *, times: int, runs: int) -> Spread:
    """The CPU time of this thread for one `operation`: the mean over `times` calls, in each of `runs` runs.

    Each call gets its number. The first tenth of the calls before the first run is not counted.
    """
    means: list[float] = []
    with quiet():
        for number in range(max(1, times // 10)):
            operation(number)
        for _ in range(runs):
            began = time.thread_time_ns()
            for number in range(times):
                operation(number)
            means.append((time.thread_time_ns() - began) / times / NANOS_PER_US)
    return Spread.of(means)


def powers(least: int, most: int) -> Sequence[int]:
    """The powers of ten of `least` up to `most`, and `most`."""
    found = []
    while least < most:
        found.append(least)
        least *= 10
    return [*found, most]
