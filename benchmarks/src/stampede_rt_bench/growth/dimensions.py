"""The dimensions of growth, and the cost of a put and a get at each size."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Match, parse_interval
from stampede_rt_bench.filling import put_run, time_of
from stampede_rt_bench.growth.groups import measure_groups
from stampede_rt_bench.growth.own_channels import NEWEST, OwnChannels, cpu_us, get, powers, put, run_of
from stampede_rt_bench.growth.readers import measure_readers
from stampede_rt_bench.measuring import PAYLOAD_BYTES, Spread, quiet
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.channel import Query

BUSY_CHANNELS_MAX = 100
HELD_ITEMS = 100
AGE_NANOS = 10 * 10**9
PAYLOADS_BYTES = (64, 1024, 18_000, 300_000, 4 * 2**20)
BYTES_PER_RUN = 2**28  # the payload bytes of one run of puts, so that runs with large payloads end soon
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")

Costs = dict[int, dict[str, Spread]]
"""By size of a dimension, the cost of each operation in microseconds of CPU time."""


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How large everything gets, the runs for each figure, and the operations of each run."""

    channels_max: int
    items_max: int
    readers_max: int
    groups_max: int
    runs: int
    operations: int


@dataclass(frozen=True)
class Dimension:
    """A dimension that grows. `what` names it on the axis; `about` describes the figures."""

    title: str
    what: str
    about: str
    measure: Callable[[Sizes], Costs]


def _channels(sizes: Sizes) -> Costs:
    """One item in each channel; a hundred of the channels are busy."""
    own, opened = OwnChannels(), list[HostedChannel]()
    costs, encoded, before_bytes = _no_costs(), run_of(PAYLOAD_BYTES), _resident_bytes()
    for count in powers(1, sizes.channels_max):
        with quiet():
            while len(opened) < count:
                opened.append(own.open(Policy(max_age_nanos=AGE_NANOS)))
                put(opened[-1], encoded)
        asyncio.run(own.sweep())
        busy = opened[:: max(1, count // BUSY_CHANNELS_MAX)]
        costs[count] = {
            "put": cpu_us(partial(_put_in_turn, busy, encoded), times=sizes.operations, runs=sizes.runs),
            "get of the newest": cpu_us(partial(_get_in_turn, busy), times=sizes.operations, runs=sizes.runs),
            "sweep after a put": _sweeps(own, partial(put, busy[0], encoded), sizes.operations, sizes.runs),
        }
        if count >= 1000:
            each_bytes = (_resident_bytes() - before_bytes) / count
            costs[count]["bytes of memory a channel"] = Spread.of([each_bytes])
    return costs


def _sweeps(own: OwnChannels, change: Callable[[], None], operations: int, runs: int) -> Spread:
    loop = asyncio.new_event_loop()
    try:

        def step(_: int) -> None:
            change()
            loop.run_until_complete(own.sweep())

        return cpu_us(step, times=max(1, operations // 10), runs=runs)
    finally:
        loop.close()


def _items(sizes: Sizes) -> Costs:
    """A full channel: each put replaces the oldest item."""
    costs, encoded = _no_costs(), run_of(PAYLOAD_BYTES)
    for count in powers(100, sizes.items_max):
        channel = OwnChannels().open(Policy(max_items=count, max_bytes=2**40))
        with quiet():
            for place in range(count):
                put_run(channel.channel, range(place, place + 1))
        middle = Query(interval=parse_interval(time_of(count // 2), time_of(count // 2)), match=Match.SPAN)
        cost_of = partial(cpu_us, times=sizes.operations, runs=sizes.runs)
        costs[count] = {
            "get by time, in the middle": cost_of(partial(_get, channel, middle)),
            "get of the newest": cost_of(partial(_get, channel, NEWEST)),
            "put": cost_of(partial(_put, channel, encoded)),
        }
    return costs


def _payloads(sizes: Sizes) -> Costs:
    costs = _no_costs()
    for size in PAYLOADS_BYTES:
        encoded = run_of(size)
        channel = OwnChannels().open(Policy(max_items=HELD_ITEMS if size < 2**20 else 10, max_bytes=2**40))
        times = max(3, min(sizes.operations, BYTES_PER_RUN // size))
        costs[size] = {
            "put": cpu_us(partial(_put, channel, encoded), times=times, runs=sizes.runs),
            "get of the newest": cpu_us(partial(_get, channel, NEWEST), times=times, runs=sizes.runs),
        }
    return costs


def _put(channel: HostedChannel, encoded: bytes, _: int) -> None:
    put(channel, encoded)


def _get(channel: HostedChannel, query: Query, _: int) -> None:
    get(channel, query)


def _put_in_turn(channels: Sequence[HostedChannel], encoded: bytes, number: int) -> None:
    put(channels[number % len(channels)], encoded)


def _get_in_turn(channels: Sequence[HostedChannel], number: int) -> None:
    get(channels[number % len(channels)], NEWEST)


def _no_costs() -> Costs:
    return {}


def _resident_bytes() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * PAGE_BYTES


_OWN = "A host's own work in one process, without gRPC: microseconds of CPU time."
DIMENSIONS: Mapping[str, Dimension] = {
    "channels": Dimension(
        "Channels of a host, 100 of them busy",
        "channels",
        f"{_OWN} Each channel has one item and max_age 10 s. "
        "The memory is the memory of the process, less its memory before the first channel.",
        _channels,
    ),
    "items": Dimension("Items in a channel", "items", f"{_OWN} Each put replaces the oldest item.", _items),
    "readers": Dimension(
        "Readers of a channel",
        "readers",
        f"{_OWN} The time of a put ends when the host has made the message for each reader. "
        "A stalled reader is one more reader, which takes nothing. The part for one reader is the time of a put, "
        "divided by the number of readers.",
        lambda sizes: measure_readers(powers(1, sizes.readers_max), sizes.operations, sizes.runs),
    ),
    "groups": Dimension(
        "Groups of a channel",
        "groups",
        "CPU time of a whole host process for one call of a client, gRPC included. A client reads through each group.",
        lambda sizes: measure_groups(powers(1, sizes.groups_max), sizes.operations, sizes.runs),
    ),
    "payload": Dimension("Payload of an item", "bytes", _OWN, _payloads),
}
