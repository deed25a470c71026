"""What a wide group costs its hosts: `python -m tests.benchmarks.wide_groups`.

64 channels at 100 items/s each, spread over 1, 2 and 4 hosts, without a group and in one group on `oldest`. All hosts
run in this one process, with real gRPC between them; items go straight into their cores, so that the difference of CPU
time is the group's alone: following the channels, exchanging times, computing cuts.
"""

from __future__ import annotations

import argparse
import asyncio
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.channel import Offer
from stampede_rt_channel_host.groups.link import Link
from tests.unit.groups.rig import Cluster, Host, running_cluster

CHANNELS, ITEMS_PER_SECOND = 64, 100
HOSTS = (1, 2, 4)
STEPS_PER_PERIOD = 10  # channels put at phases of their own, so that nothing is coalesced by coming together
WARM_SECONDS = 1.0


class Messages:
    """Counts what links send while it is in place."""

    def __init__(self) -> None:
        self.sent = 0
        self._gather = Link._gather

    def __enter__(self) -> Messages:
        def gather(link: Link) -> Any:
            self.sent += 1
            return self._gather(link)

        Link._gather = gather  # type: ignore[method-assign]
        return self

    def __exit__(self, *_: object) -> None:
        Link._gather = self._gather  # type: ignore[method-assign]


@dataclass(frozen=True)
class Cost:
    """Of one run: items put a second, CPU for each in microseconds, exchange messages a second, the cut's worst lag."""

    items_per_second: float
    cpu_us_per_item: float
    messages_per_second: float
    lag_ms: float


async def measure(hosts: int, seconds: float, *, grouped: bool) -> Cost:
    async with running_cluster() as cluster:
        channels = await _channels(cluster, hosts)
        if grouped:
            group = cluster.directory.add_group("wide", channels)
            for host in cluster.hosts:
                await _cut(host, group)
        hosted = [one.host.host.store.find(one.channel_id, one.record.epoch) for one in channels]
        await _put(hosted, WARM_SECONDS)
        with Messages() as messages:
            cpu, wall = time.process_time(), time.monotonic()
            items = await _put(hosted, seconds)
            cpu, wall = time.process_time() - cpu, time.monotonic() - wall
        lag = await _lag(cluster, group) if grouped else 0.0
        return Cost(items / wall, cpu / items * 1e6, messages.sent / wall, lag)


async def _channels(cluster: Cluster, hosts: int) -> list[Any]:
    for number in range(hosts):
        await cluster.start(f"h{number}", bytes([number + 1]) * 16)
    spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=1000))
    return [await cluster.hosts[number % hosts].open(f"c{number}", spec=spec) for number in range(CHANNELS)]


async def _put(hosted: Sequence[HostedChannel], seconds: float) -> int:
    """Every channel one item in each period, at its own phase; how many in all."""
    step = 1.0 / ITEMS_PER_SECOND / STEPS_PER_PERIOD
    steps = round(seconds / step)
    began = time.monotonic()
    items = 0
    for number in range(steps):
        for channel in hosted[number % STEPS_PER_PERIOD :: STEPS_PER_PERIOD]:
            _put_one(channel)
            items += 1
        await asyncio.sleep(max(0.0, began + (number + 1) * step - time.monotonic()))
    return items


def _put_one(hosted: HostedChannel) -> None:
    now = time.time_ns()
    raw = encode_run([b"x" * 64], times=[now])
    hosted.channel.put(
        Offer(times=[now], durations=None, lengths=[64]), now, lambda first_seq, kept, stamped: seal_run(raw, first_seq)
    )
    hosted.changed(now)


async def _lag(cluster: Cluster, group: Any) -> float:
    """How far behind now the cut is at the host that is furthest behind, right after the last put."""
    last = time.time_ns()
    cuts = [await _cut(host, group) for host in cluster.hosts]
    return (last - min(cuts)) / 1e6


async def _cut(host: Host, group: Any) -> int:
    response = await host.groups.GetCut(pb.GetCutRequest(group_id=group.group_id))
    return int(response.floor.cut_unix_nano)


async def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    seconds = parser.parse_args().seconds
    print(
        f"{'hosts':>5} {'pairs':>5} {'items/s':>8} {'CPU us/item, alone':>19} {'in a group':>11} {'messages/s':>11} "
        f"{'for an item':>12} {'cut behind, ms':>15}"
    )
    for hosts in HOSTS:
        alone = await measure(hosts, seconds, grouped=False)
        group = await measure(hosts, seconds, grouped=True)
        per_item = group.messages_per_second / group.items_per_second
        print(f"{hosts:5} {hosts * (hosts - 1) // 2:5} {group.items_per_second:8,.0f} {alone.cpu_us_per_item:19.1f} "
              f"{group.cpu_us_per_item:11.1f} {group.messages_per_second:11,.0f} {per_item:12.3f} {group.lag_ms:15.1f}",
              flush=True)  # fmt: skip


if __name__ == "__main__":
    asyncio.run(main())
