"""Figure 4 of the paper: the cost of one get by time, by the number of held items and the position of the item.

Like the paper's figure, the first line measures the core of the host: a get by reference. Another line measures the
same get of a client over gRPC, from a host in another process. A third line measures `Channel.at` of a program that
hosts the channel itself: it returns the very payload that the program has put. For comparison there is the code that a
user would write: a search in a SortedDict from time to payload for the newest time that is not later. This code knows
no spans, seqs or reasons, and shows only the cost of the search in Python.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from sortedcontainers import SortedDict

import stampede_rt as st
from stampede_rt.values.timeline import parse_interval
from stampede_rt_bench.charts import Axes, draw_lines
from stampede_rt_bench.clusters import connected, running
from stampede_rt_bench.filling import (
    PERIOD_NANOS,
    REMOTE_PERIOD_NANOS,
    filled_channel,
    filled_embedded_channel,
    filled_remote_channel,
    time_of,
)
from stampede_rt_bench.measuring import PAYLOAD_BYTES, Effort, Spread, microseconds
from stampede_rt_bench.tables import Table, number, spread
from stampede_rt_channel_host.core.channel import ChannelCore, Query

GETS_PER_RUN = 20_000
POSITIONS = {"early": 0.01, "middle": 0.5, "late": 0.99}
BY_HAND = "by hand, middle"
OVER_GRPC = "over gRPC, middle"
EMBEDDED = "embedded host, middle"
REMOTE_GETS = 500
EMBEDDED_GETS = 5_000
EMBEDDED_MEMORY = "16GiB"
FEWEST, JUDGED_FROM = 10, 1000


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the chart of one get."""
    lines: dict[str, list[tuple[float, Spread]]] = {name: [] for name in (*POSITIONS, BY_HAND)}
    for items in effort.sizes(FEWEST):
        for name, value in _of_channel(items, effort.runs).items():
            lines[name].append((items, value))
        lines[BY_HAND].append((items, _of_sorted_dict(items, effort.runs)))
    lines[OVER_GRPC] = _over_grpc(effort)
    lines[EMBEDDED] = _embedded(effort)
    title = f"One get by time, items of {PAYLOAD_BYTES} B, put one by one"
    draw_lines(chart, Axes(title=title, x="items in the channel", y="microseconds"), lines)
    return _table(lines)


def _of_channel(items: int, runs: int) -> dict[str, Spread]:
    channel = filled_channel(items)
    return {
        name: microseconds(_get(channel, items, share), times=GETS_PER_RUN, runs=runs)
        for name, share in POSITIONS.items()
    }


def _get(channel: ChannelCore, items: int, share: float) -> Callable[[], object]:
    """Return a get of the items whose span contains an instant in the middle of one item's span."""
    instant = time_of(int(items * share)) + PERIOD_NANOS // 2
    query, now = Query(interval=parse_interval(instant, instant)), time_of(items)
    if len(channel.read(query, now).slices) != 1:
        raise AssertionError(f"the item at {share:.0%} of {items} is not there")
    return lambda: channel.read(query, now)


def _of_sorted_dict(items: int, runs: int) -> Spread:
    payload = bytes(PAYLOAD_BYTES)
    by_time = SortedDict((time_of(place), payload) for place in range(items))
    instant = time_of(items // 2) + PERIOD_NANOS // 2

    def get() -> bytes:
        found: bytes = by_time.peekitem(by_time.bisect_right(instant) - 1)[1]
        return found

    return microseconds(get, times=GETS_PER_RUN, runs=runs)


def _over_grpc(effort: Effort) -> list[tuple[float, Spread]]:
    points: list[tuple[float, Spread]] = []
    with connected() as rt:
        for items in effort.sizes(FEWEST):
            channel = filled_remote_channel(rt, items)
            newest = channel.newest()
            assert newest is not None
            instant = newest.time - items // 2 * REMOTE_PERIOD_NANOS + REMOTE_PERIOD_NANOS // 2
            if len(channel.at(instant)) != 1:
                raise AssertionError(f"the item in the middle of {items} is not there")
            points.append((items, microseconds(partial(channel.at, instant), times=REMOTE_GETS, runs=effort.runs)))
    return points


def _embedded(effort: Effort) -> list[tuple[float, Spread]]:
    points: list[tuple[float, Spread]] = []
    with running(hosts=0) as address, st.host(address, max_memory=EMBEDDED_MEMORY) as rt:
        for items in effort.sizes(FEWEST):
            channel, middle = filled_embedded_channel(rt, items)
            instant = middle.time + REMOTE_PERIOD_NANOS // 2
            if channel.at(instant)[0].payload is not middle.payload:
                raise AssertionError(f"the item in the middle of {items} is not returned by reference")
            points.append((items, microseconds(partial(channel.at, instant), times=EMBEDDED_GETS, runs=effort.runs)))
            channel.delete()
    return points


def _table(lines: dict[str, list[tuple[float, Spread]]]) -> Table:
    table = Table(["items", *(f"{name}, us" for name in lines)])
    for place, (items, _) in enumerate(lines["early"]):
        table.rows.append([number(items), *(spread(points[place][1]) for points in lines.values())])
    means = [
        [points[place][1].median for name, points in lines.items() if name in POSITIONS]
        for place, (items, _) in enumerate(lines["early"])
        if items >= JUDGED_FROM
    ]
    embedded = [points.median for items, points in lines[EMBEDDED] if items >= JUDGED_FROM]
    growth = max(last / first for first, last in zip(means[0], means[-1], strict=True))
    between = max(max(row) / min(row) for row in means)
    table.notes = [
        "early, middle, late: the host's core alone, as in the paper; over gRPC: from a client to a host process.",
        f"From {JUDGED_FROM:,} items to the largest channel the cost grows {growth:.2f} times at the most (goal: 3);",
        f"no position costs more than {between:.2f} times another (goal: 2). Medians (least to most) of the runs.",
        f"Embedded host: a get by reference grows {max(embedded) / embedded[0]:.2f} times (goal: under 20 us, flat).",
        "Paper: 2.2 GHz dual-core Opteron, 5 runs of 10,000,000 gets; its times are in a graph that our copy lacks.",
    ]
    return table
