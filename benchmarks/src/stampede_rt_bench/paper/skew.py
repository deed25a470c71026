"""Figure 7 of the paper: how far apart two consumers get what belongs together, with a group and without.

A producer puts 30 frames and 2 captions a second; one consumer takes the frames, another the captions, each in a
process of its own, their channels at different hosts. The consumers do not talk to each other. A frame's skew is the
time between its receipt and that of the caption in whose span it begins; a run's skew is the root of the mean of its
squares.
"""

from __future__ import annotations

import math
import multiprocessing
import statistics
import threading
import time
from bisect import bisect_right
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import stampede_rt as st
from stampede_rt.timeline import MAX_INSTANT
from stampede_rt_bench.charts import Axes, draw_lines
from stampede_rt_bench.clusters import running
from stampede_rt_bench.measuring import Effort, Spread
from stampede_rt_bench.tables import Table, spread

SECONDS = 8
NANOS_PER_SECOND, NANOS_PER_MS = 1_000_000_000, 1_000_000
FRAME_NANOS, CAPTION_NANOS = NANOS_PER_SECOND // 30, NANOS_PER_SECOND // 2
FRAME_BYTES, CAPTION_BYTES = 18_000, 512
FRAMES_PER_CAPTION = CAPTION_NANOS // FRAME_NANOS
VIDEO, CAPTIONS, GROUP = "bench/video", "bench/captions", "bench/skew"
LEAD_NANOS = 3 * NANOS_PER_SECOND
GOAL_MS = 10.0

Receipt = tuple[int, int, int]
"""An item's time, when it was received, and how many items came with it in one get."""


class Run(NamedTuple):
    """One run: each frame's place in the caption's span and its skew, and how many frames came in one get with it."""

    skews_ms: Sequence[tuple[int, float]]
    frames_per_get: Sequence[int]

    @property
    def skew_ms(self) -> float:
        """The root of the mean square."""
        return math.sqrt(statistics.fmean(skew * skew for _, skew in self.skews_ms))


def measure(effort: Effort, chart: Path) -> Table:
    """The table and the chart of skew, grouped and not."""
    table = Table(["consumers read", "skew of a frame, ms", "a frame comes with"])
    lines: dict[str, list[tuple[float, Spread]]] = {}
    for name, grouped in (("through a group", True), ("each its channel", False)):
        runs = [_run(grouped=grouped) for _ in range(effort.runs)]
        lines[name] = _by_place(runs)
        frames = Spread.of([statistics.median(run.frames_per_get) for run in runs])
        table.rows.append([name, spread(Spread.of([run.skew_ms for run in runs])), f"{frames.median:.0f} in one get"])
    title = "Skew of 30 frames and 2 captions a second between two consumers"
    axes = Axes(title=title, x="frame of the caption's span", y="milliseconds", log_y=True, log_x=False)
    draw_lines(chart, axes, lines)
    table.notes = [
        f"{effort.runs} runs of {SECONDS} s; the median of the runs (least to most).",
        f"The goal through a group is {GOAL_MS:g} ms, 2 % of a caption's period.",
    ]
    return table


def _by_place(runs: Sequence[Run]) -> list[tuple[float, Spread]]:
    """The median skew of the first, second, ... frame of a span, over the runs."""
    places = range(FRAMES_PER_CAPTION)
    return [
        (place, Spread.of([statistics.median([ms for at, ms in run.skews_ms if at == place] or [0.0]) for run in runs]))
        for place in places
    ]


def _run(*, grouped: bool) -> Run:
    context = multiprocessing.get_context("spawn")
    with running(hosts=2) as address, st.connect(address) as rt, context.Pool(2) as pool:
        hosts = [host.name for host in rt.hosts()]
        channels = [
            rt.channel(name, max_age="30s", host=host) for name, host in zip((VIDEO, CAPTIONS), hosts, strict=True)
        ]
        rt.group(GROUP, channels, reference="oldest")
        start = time.time_ns() + LEAD_NANOS
        until = start + SECONDS * NANOS_PER_SECOND
        consumers = [pool.apply_async(consume, (address, name, grouped, start, until)) for name in (VIDEO, CAPTIONS)]
        _produce(channels, start, until)
        frames, captions = (consumer.get(timeout=SECONDS + 30) for consumer in consumers)
    return _judge(frames, captions)


def _produce(channels: Sequence[st.Channel], start: int, until: int) -> None:
    """Two threads, as in the paper: frames and captions when they are due."""
    video, captions = channels
    threads = [
        threading.Thread(target=_put_all, args=(video, start, until, FRAME_NANOS, FRAME_BYTES)),
        threading.Thread(target=_put_all, args=(captions, start, until, CAPTION_NANOS, CAPTION_BYTES)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _put_all(channel: st.Channel, start: int, until: int, period_nanos: int, payload_bytes: int) -> None:
    for due in range(start, until, period_nanos):
        time.sleep(max(0, due - time.time_ns()) / NANOS_PER_SECOND)
        channel.put(bytes(payload_bytes), time=due)


def consume(address: str, name: str, grouped: bool, start: int, until: int) -> list[Receipt]:
    """In a process of its own: everything of a channel as it can be had, newer than what is there."""
    receipts: list[Receipt] = []
    with st.connect(address) as rt:
        source: st.Channel | st.GroupChannel = rt.group(GROUP)[name] if grouped else rt.channel(name, create=False)
        behind = start - 1
        while time.time_ns() < until:
            items = source.get(behind, MAX_INSTANT, bounds="(]", match="start", timeout=0.5)
            received = time.time_ns()
            receipts += [(item.time, received, len(items)) for item in items]
            behind = items[-1].time if items else behind
    return receipts


def _judge(frames: Sequence[Receipt], captions: Sequence[Receipt]) -> Run:
    """Each frame against the caption in whose span it begins; the last caption's span may not be over."""
    times = [at for at, _, _ in captions]
    skews = []
    for at, received, _ in frames:
        place = bisect_right(times, at) - 1
        if 0 <= place < len(captions) - 1:
            skew = abs(received - captions[place][1]) / NANOS_PER_MS
            skews.append((min((at - times[place]) // FRAME_NANOS, FRAMES_PER_CAPTION - 1), skew))
    if not skews:
        raise AssertionError("no frame lay in a caption's span; was nothing received?")
    return Run(skews, [count for _, _, count in frames])
