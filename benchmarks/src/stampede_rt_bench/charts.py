"""Draws charts as PNG files.

Colours are from the Okabe-Ito palette. A reader who sees no colours gets the same information. The first drawing
imports matplotlib: this import takes a second, and most programs that import this module draw nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from stampede_rt_bench.measuring import Spread

if TYPE_CHECKING:
    from matplotlib import axes as plots

COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#767676", "#56B4E9", "#CC79A7", "#000000")
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*", "<", ">")
HATCHES = ("", "//", "..", "xx", "\\\\", "--", "++", "oo", "**", "||")
INK, GRID, FAINT, CUT = "#222222", "#dddddd", "#767676", "#D55E00"
DOTS_PER_INCH = 150

Points = Sequence[tuple[float, Spread]]


@dataclass(frozen=True, kw_only=True)
class Axes:
    """The title and axes of a chart; `goal` is a bound, drawn as a line across."""

    title: str
    x: str
    y: str
    log_y: bool = False
    log_x: bool = True
    goal: float | None = None


def draw_lines(path: Path, axes: Axes, lines: Mapping[str, Points]) -> None:
    """Draw lines through the medians, with bars from the least to the greatest value. Raises OSError."""
    with _drawn(path, axes.title, (7.5, 4.6)) as plot:
        xs = sorted({x for points in lines.values() for x, _ in points})
        log_x = axes.log_x and len(xs) > 1  # a single point needs no scale
        plot.set(xscale="log" if log_x else "linear", yscale="log" if axes.log_y else "linear")
        for number, (label, points) in enumerate(lines.items()):
            _draw_line(plot, number, label, points)
        if axes.goal is not None:
            plot.axhline(axes.goal, color=FAINT, linestyle="--", linewidth=1.2, label=f"goal: {axes.goal:g}")
        if axes.log_y:
            values = [value for points in lines.values() for _, value in points]
            plot.set_ylim(min(one.least for one in values) / 1.5, max(one.most for one in values) * 1.5)
        else:
            plot.set_ylim(bottom=0)
        _set_scales(plot, axes, xs)
        plot.grid(color=GRID, which="major")
        if len(lines) > 1:
            plot.legend(facecolor="white", edgecolor="none", framealpha=1.0)
        else:
            _write_medians(plot, next(iter(lines.values())))


def _draw_line(plot: plots.Axes, number: int, label: str, points: Points) -> None:
    xs, medians = [x for x, _ in points], [value.median for _, value in points]
    bars = [[value.median - value.least for _, value in points], [value.most - value.median for _, value in points]]
    colour, mark = COLOURS[number % len(COLOURS)], MARKS[number % len(MARKS)]
    plot.plot(xs, medians, linewidth=1.8, markersize=6, color=colour, marker=mark, label=label)
    plot.errorbar(xs, medians, yerr=bars, capsize=3, linestyle="none", color=colour)


def _set_scales(plot: plots.Axes, axes: Axes, xs: Sequence[float]) -> None:
    """Set a tick at every measured x, with full numbers."""
    from matplotlib.ticker import NullLocator

    plot.set(xlabel=axes.x, ylabel=axes.y)
    plot.set_xticks(xs, [f"{x:,g}" if x < 1e6 else f"{x:,.0f}" for x in xs])
    plot.xaxis.set_minor_locator(NullLocator())
    plot.yaxis.set_major_formatter(_full_number)


def _full_number(value: float, _place: float) -> str:
    return f"{value:,g}" if value < 1e6 else f"{value:,.0f}"


def _write_medians(plot: plots.Axes, points: Points) -> None:
    for x, value in points:
        plot.annotate(f"{value.median:,.0f}", (x, value.most), (0, 7), textcoords="offset points", ha="center")


def draw_bars(path: Path, title: str, unit: str, groups: Mapping[str, Mapping[str, Spread]]) -> None:
    """Draw groups of bars on a logarithmic scale, each with its median. Raises OSError."""
    names = list(dict.fromkeys(name for bars in groups.values() for name in bars))
    height = 1.2 + sum(0.28 * len(bars) + 0.35 for bars in groups.values())
    with _drawn(path, title, (9, height)) as plot:
        place, ticks = 0.0, []
        for bars in groups.values():
            ticks.append(place - 0.28 * (len(bars) - 1) / 2)
            for name, value in bars.items():
                _draw_bar(plot, place, names.index(name), name, value)
                place -= 0.28
            place -= 0.35
        plot.set(xscale="log", xlabel=unit)
        plot.set_yticks(ticks, list(groups))
        plot.tick_params(axis="y", length=0)
        plot.xaxis.set_major_formatter(_full_number)
        plot.margins(x=0.15)


def _draw_bar(plot: plots.Axes, place: float, number: int, name: str, value: Spread) -> None:
    colour, hatch = COLOURS[number % len(COLOURS)], HATCHES[number % len(HATCHES)]
    reach = [[value.median - value.least], [value.most - value.median]]
    plot.barh(place, value.median, height=0.25, facecolor=colour, hatch=hatch, edgecolor="white")
    plot.errorbar(value.median, place, xerr=reach, color=INK, capsize=2, linestyle="none", linewidth=0.9)
    text = f" {name}: {value.median:,.0f}"
    plot.annotate(text, (value.most, place), (3, 0), textcoords="offset points", va="center", fontsize=8)


class Span(NamedTuple):
    """One item's span in seconds, and whether it was visible."""

    start_s: float
    end_s: float
    visible: bool


class Lane(NamedTuple):
    """A stream's spans, and the group's cut at that moment."""

    label: str
    spans: Sequence[Span]
    cut_s: float


def draw_spans(path: Path, title: str, lanes: Sequence[Lane]) -> None:
    """Draw spans on lanes: filled if visible, otherwise with a dashed edge. Raises OSError."""
    with _drawn(path, title, (9, 1.4 + 0.75 * len(lanes))) as plot:
        for place, lane in enumerate(lanes):
            colour = COLOURS[place % 2]
            for shown, style in ((True, {"facecolor": colour, "alpha": 0.45}),
                                 (False, {"facecolor": "white", "linestyle": "--"})):  # fmt: skip
                parts = [(span.start_s, span.end_s - span.start_s) for span in lane.spans if span.visible is shown]
                plot.broken_barh(parts, (-place - 0.3, 0.6), edgecolor=INK, linewidth=0.8, **style)
            plot.vlines(lane.cut_s, -place - 0.42, -place + 0.42, color=CUT, linewidth=2.5)
        plot.annotate("the cut", (lanes[0].cut_s, 0.42), (0, 3), textcoords="offset points", ha="center", color=CUT)
        plot.set_yticks([-place for place in range(len(lanes))], [lane.label for lane in lanes])
        plot.tick_params(axis="y", length=0)
        plot.spines["left"].set_visible(False)
        plot.set(xlabel="seconds; filled: visible through the group, dashed: hidden")


@contextmanager
def _drawn(path: Path, title: str, inches: tuple[float, float]) -> Iterator[plots.Axes]:
    """Yield an empty plot with a title, and write it to `path` at the end."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 10, "text.color": INK, "axes.edgecolor": INK})
    figure, plot = plt.subplots(figsize=inches, layout="constrained")
    try:
        plot.spines[["top", "right"]].set_visible(False)
        plot.set_title(title, loc="left", fontweight="bold")
        yield plot
        figure.savefig(path, dpi=DOTS_PER_INCH)
    finally:
        plt.close(figure)
