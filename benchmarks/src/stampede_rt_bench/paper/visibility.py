"""Figure 3 of the paper: the items of text and audio that a group shows and hides, as its consumers see them.

Text items of 1 s and audio blocks of 125 ms are at different hosts, and audio is ahead of the text. The reference is
the text, and the cut is the end of its newest item.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import stampede_rt as st
from stampede_rt_bench.charts import Lane, Span, draw_spans
from stampede_rt_bench.clusters import connected
from stampede_rt_bench.measuring import Effort
from stampede_rt_bench.tables import Table, number

NANOS_PER_SECOND = 1_000_000_000
TEXT_NANOS, AUDIO_NANOS = NANOS_PER_SECOND, NANOS_PER_SECOND // 8
TEXTS, BLOCKS, NEXT_TEXTS = 2, 20, 3
READ_SECONDS = 10.0


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the chart of the visible items before and after the next text item. `effort` has no effect."""
    table = Table(["", "put", "visible", "hidden", "cut at, s"])
    with connected(hosts=2) as rt:
        hosts = [host.name for host in rt.hosts()]
        text, audio = (
            rt.channel(f"bench/{name}", max_age="60s", host=host)
            for name, host in zip(("text", "audio"), hosts, strict=True)
        )
        group = rt.group("bench/visibility", [text, audio], reference=text, bound="end")
        base = st.now() - 10 * NANOS_PER_SECOND
        _put(text, base, range(TEXTS), TEXT_NANOS)
        _put(audio, base, range(BLOCKS), AUDIO_NANOS)
        lanes = _look(table, "before the next text", group, (text, audio), base)
        _put(text, base, range(TEXTS, NEXT_TEXTS), TEXT_NANOS)
        after = _look(table, "after it", group, (text, audio), base)
    draw_spans(chart, "What a group of text and audio shows (the paper's Figure 3)", [*lanes, *after])
    table.notes = ["Each stream is read through the group by its own descriptor; hidden items wait for the next text."]
    return table


def _put(channel: st.Channel, base: int, places: range, period_nanos: int) -> None:
    for place in places:
        channel.put(b"x", time=base + place * period_nanos, duration=f"{period_nanos}ns")


def _look(table: Table, when: str, group: st.Group, channels: Sequence[st.Channel], base: int) -> list[Lane]:
    """Return the items of each channel, and the items that a reader of the group gets, when the cut has stopped."""
    end = base + 60 * NANOS_PER_SECOND
    newest = channels[0].newest()
    assert newest is not None
    assert newest.end is not None
    lanes: list[Lane] = []
    for channel in channels:
        group[channel].get(base, newest.end, bounds="[)", match="start", complete=True, timeout=READ_SECONDS)
        shown, held = (one.get(base, end, match="start") for one in (group[channel], channel))
        assert shown.cut is not None
        cut_s = (shown.cut - base) / NANOS_PER_SECOND
        counts = (len(held), len(shown), len(held) - len(shown))
        table.rows.append([f"{channel.name}, {when}", *map(number, counts), number(cut_s, 3)])
        visible = {item.seq for item in shown}
        spans = [Span((item.time - base) / 1e9, ((item.end or end) - base) / 1e9, item.seq in visible) for item in held]
        lanes.append(Lane(f"{channel.name.removeprefix('bench/')},\n{when}", spans, cut_s))
    return lanes
