"""Figure 7 of the paper: the time between the receipts of related items at two consumers, with a group and without.

A frame's skew is the time between its receipt and the receipt of the caption in whose span it begins. A run's skew is
the root mean square. One clock measures all receipts, because namespaces share the clock of their machine.
"""

from __future__ import annotations

import math
import statistics
from bisect import bisect_right
from collections import Counter
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from stampede_rt_bench.charts import Axes, draw_lines
from stampede_rt_bench.measuring import Effort, Spread
from stampede_rt_bench.paper.captioned_video import (
    CAPTIONS_PER_SECOND,
    FRAME_NANOS,
    FRAMES_PER_CAPTION,
    MACHINES,
    NANOS_PER_MS,
    SECONDS,
    Receipt,
    Setting,
    play,
)
from stampede_rt_bench.tables import Table, spread
from stampede_rt_local.namespaces import NamespaceNetwork, unavailable_because

GOAL_MS = 0.02 * 1000 / CAPTIONS_PER_SECOND
BETWEEN = Setting(name="captions between frames", captions_after_nanos=FRAME_NANOS // 2, decoding_nanos=0)
SETTINGS = (
    Setting(name="through a group"),
    BETWEEN,
    replace(BETWEEN, name="the same, bound end", bound="end"),
    Setting(name="no group", grouped=False),
)


class SkewRun(NamedTuple):
    """The result of one run.

    `skews_ms`: for each frame its index in its caption's span, and its skew. `frames_together`: for each caption the
    most frames that came in one get.
    """

    skews_ms: Sequence[tuple[int, float]]
    frames_together: Sequence[int]

    @property
    def skew_ms(self) -> float:
        """Return the root mean square of the skew."""
        return math.sqrt(statistics.fmean(skew * skew for _, skew in self.skews_ms))


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the chart of the skew, with a group and without."""
    table = Table(["consumers read", "skew of a frame, ms", "of a caption's 15 frames in one get"])
    lines: dict[str, list[tuple[float, Spread]]] = {}
    why_not = unavailable_because()
    with nullcontext() if why_not else NamespaceNetwork(MACHINES) as network:
        for setting in SETTINGS:
            runs = [judge(*play(setting, network)) for _ in range(effort.runs)]
            lines[setting.name] = _by_place(runs)
            together = Spread.of([count for run in runs for count in run.frames_together])
            skew = Spread.of([run.skew_ms for run in runs])
            table.rows.append([setting.name, spread(skew), spread(together, digits=0)])
    title = "Skew of 30 frames and 2 captions a second between two consumers"
    axes = Axes(title=title, x="frame of the caption's span", y="milliseconds", log_y=True, log_x=False, goal=GOAL_MS)
    draw_lines(chart, axes, lines)
    table.notes = _notes(effort, why_not)
    return table


def _notes(effort: Effort, why_not: str | None) -> list[str]:
    where = "Each host and each consumer is in a network namespace of its own; a bridge joins them."
    if why_not:
        where = f"All processes share this machine's loopback: {why_not}."
    return [
        f"Runs of {SECONDS} s, {effort.runs} for each row; medians (least to most), of captions over all runs.",
        where,
        f"The goal through a group is {GOAL_MS:g} ms, 2 % of a caption's period.",
        "Paper: 15 frames of a caption in one get through a group; its skews are in a graph that our copy lacks.",
    ]


def _by_place(runs: Sequence[SkewRun]) -> list[tuple[float, Spread]]:
    """Return the median skew of the first, second, ... frame of a span, over the runs."""
    points = []
    for place in range(FRAMES_PER_CAPTION):
        medians = [[ms for at, ms in run.skews_ms if at == place] for run in runs]
        points.append((place + 1.0, Spread.of([statistics.median(skews) for skews in medians if skews])))
    return points


def judge(frames: Sequence[Receipt], captions: Sequence[Receipt]) -> SkewRun:
    """Compare each frame with the caption in whose span it begins. The last caption's span may not be over.

    Raises AssertionError if a caption between the first and the last lacks frames.
    """
    times = [caption.time for caption in captions]
    skews: list[tuple[int, float]] = []
    together: dict[int, Counter[int]] = {number: Counter() for number in range(len(captions) - 1)}
    for frame in frames:
        number = bisect_right(times, frame.time) - 1
        if number not in together:
            continue
        skew = abs(frame.received - captions[number].received) / NANOS_PER_MS
        skews.append(((frame.time - times[number]) // FRAME_NANOS, skew))
        together[number][frame.received] += 1
    wrong = [number for number, gets in together.items() if gets.total() != FRAMES_PER_CAPTION]
    if wrong or not skews:
        raise AssertionError(f"{len(captions)} captions came. These have not {FRAMES_PER_CAPTION} frames each: {wrong}")
    return SkewRun(skews, [max(gets.values()) for gets in together.values()])
