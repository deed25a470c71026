"""Charts as PNG files. Colours are from the Okabe-Ito palette; nothing is said by colour alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot as plt

from stampede_rt_bench.measuring import Spread

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#767676")
MARKS = ("o", "s", "^", "D", "v")
INK, GRID = "#222222", "#dddddd"


@dataclass(frozen=True, kw_only=True)
class Axes:
    """What a chart says besides its lines."""

    title: str
    x: str
    y: str
    log_y: bool = False
    log_x: bool = True


def draw_lines(path: Path, axes: Axes, lines: Mapping[str, Sequence[tuple[float, Spread]]]) -> None:
    """Lines, medians with bars from the least to the most. Raises OSError."""
    plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 10, "text.color": INK, "axes.edgecolor": INK})
    figure, plot = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
    try:
        for number, (label, points) in enumerate(lines.items()):
            xs, medians = [x for x, _ in points], [value.median for _, value in points]
            bars = [
                [value.median - value.least for _, value in points],
                [value.most - value.median for _, value in points],
            ]
            colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
            plot.errorbar(
                xs, medians, yerr=bars, capsize=3, linewidth=1.8, markersize=6, color=colour, marker=mark, label=label
            )
        plot.set(xscale="log" if axes.log_x else "linear", xlabel=axes.x, ylabel=axes.y)
        if axes.log_y:
            plot.set_yscale("log")
        else:
            plot.set_ylim(bottom=0)
        plot.set_title(axes.title, loc="left", fontweight="bold")
        plot.grid(color=GRID, which="major")
        plot.spines[["top", "right"]].set_visible(False)
        plot.legend(frameon=False)
        figure.savefig(path, dpi=150)
    finally:
        plt.close(figure)


class Span(NamedTuple):
    """One item's span in seconds, and whether it was visible."""

    start_s: float
    end_s: float
    visible: bool


def draw_spans(path: Path, title: str, lanes: Sequence[tuple[str, Sequence[Span]]]) -> None:
    """Spans on lanes below each other: filled if visible, else with a dashed edge. Raises OSError."""
    plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 10, "text.color": INK, "axes.edgecolor": INK})
    figure, plot = plt.subplots(figsize=(9, 1.2 + 0.8 * len(lanes)), layout="constrained")
    try:
        for place, (_, spans) in enumerate(lanes):
            colour = COLOURS[place % 2]
            for shown, style in ((True, {"facecolor": colour, "alpha": 0.45}),
                                 (False, {"facecolor": "white", "linestyle": "--"})):  # fmt: skip
                parts = [(span.start_s, span.end_s - span.start_s) for span in spans if span.visible is shown]
                plot.broken_barh(parts, (-place - 0.3, 0.6), edgecolor=INK, linewidth=0.8, **style)
        plot.set_yticks([-place for place in range(len(lanes))], [label for label, _ in lanes])
        plot.set(xlabel="seconds")
        plot.set_title(f"{title}\nfilled: visible through the group; dashed: hidden", loc="left", fontsize=11)
        plot.spines[["top", "right", "left"]].set_visible(False)
        figure.savefig(path, dpi=150)
    finally:
        plt.close(figure)
