"""The cost of an interval get by the number of returned items: only at the host, and for a client over gRPC.

In the paper (section 6) the cost is about linear in the number of returned items.
"""

from __future__ import annotations

from pathlib import Path

import stampede_rt as st
from stampede_rt.values.timeline import parse_interval
from stampede_rt_bench.charts import Axes, draw_lines
from stampede_rt_bench.clusters import connected
from stampede_rt_bench.filling import filled_channel, filled_remote_channel, time_of
from stampede_rt_bench.measuring import PAYLOAD_BYTES, Effort, Spread, microseconds
from stampede_rt_bench.tables import Table, number, spread
from stampede_rt_channel_host.core.channel import Query

HELD_ITEMS_MAX = 1_000_000
RETURNED = (1, 10, 100, 1000, 10_000, 100_000)
ITEMS_PER_RUN = 200_000
GETS_MAX = 5000
RUN_ITEMS = 256

Points = list[tuple[float, Spread]]


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the chart of interval gets."""
    held = min(effort.items_max, HELD_ITEMS_MAX)
    returned = [count for count in RETURNED if count <= held // 2]
    lines = {
        "at the host, put one by one": _at_host(held, returned, effort.runs, run_items=1),
        f"at the host, put in runs of {RUN_ITEMS}": _at_host(held, returned, effort.runs, run_items=RUN_ITEMS),
        f"over gRPC, put in runs of {RUN_ITEMS}": _over_grpc(held, returned, effort.runs),
    }
    title = f"One interval get from a channel of {held:,} items of {PAYLOAD_BYTES} B"
    draw_lines(chart, Axes(title=title, x="items returned", y="microseconds", log_y=True), lines)
    return _table(lines)


def _gets(count: int) -> int:
    return max(1, min(GETS_MAX, ITEMS_PER_RUN // count))


def _at_host(held: int, returned: list[int], runs: int, *, run_items: int) -> Points:
    channel, now = filled_channel(held, run_items=run_items), time_of(held)
    points: Points = []
    for count in returned:
        first = held // 2 - count // 2
        query = Query(interval=parse_interval(time_of(first), time_of(first + count), "[)"))
        found = sum(part.hi - part.lo for part in channel.read(query, now).slices)
        if found != count:
            raise AssertionError(f"{found} items came instead of {count}")
        points.append((count, microseconds(lambda q=query: channel.read(q, now), times=_gets(count), runs=runs)))  # type: ignore[misc]
    return points


def _over_grpc(held: int, returned: list[int], runs: int) -> Points:
    points: Points = []
    with connected() as rt:
        channel = filled_remote_channel(rt, held)
        oldest = channel.oldest()
        assert oldest is not None
        for count in returned:

            def get(count: int = count) -> None:
                if len(channel.get(oldest.time, st.NEWEST, limit=count)) != count:
                    raise AssertionError(f"fewer than {count} items came")

            points.append((count, microseconds(get, times=max(1, _gets(count) // 10), runs=runs)))
    return points


def _table(lines: dict[str, Points]) -> Table:
    table = Table(["returned", *(f"{name}, us" for name in lines), "gRPC, for an item, us"])
    for place, (count, _) in enumerate(next(iter(lines.values()))):
        remote = list(lines.values())[-1][place][1]
        cells = [spread(points[place][1]) for points in lines.values()]
        table.rows.append([number(int(count)), *cells, number(remote.median / count, 2)])
    table.notes = [
        "At the host an answer refers to stored runs; a client makes an Item for each item. Medians (least to most).",
        "Paper: the time of a get grows about linearly with the items returned; it gives no figures.",
    ]
    return table
