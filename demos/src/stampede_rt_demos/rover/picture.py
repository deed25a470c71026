"""Draws the picture of the rover demo: how long each put took, the pairs, and what happened to the hosts."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine

from stampede_rt_demos.rover.report import NANOS_PER_MS, NANOS_PER_SECOND, RoverReport
from stampede_rt_demos.staging.film import ATTRIBUTION

BLUE, ORANGE, INK, FAINT = "#0072B2", "#E69F00", "#222222", "#767676"
TITLE = "A rover hosts its cameras itself, is drained, and the next host is killed"


def draw(report: RoverReport, path: Path) -> None:
    """Draw a PNG at `path`. Raises ValueError if there was no pair, OSError if the file cannot be written."""
    if not report.measured:
        raise ValueError("the consumer got no pair, so there is nothing to draw; run for longer")
    plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 9.5, "text.color": INK})
    figure, (puts, pairs) = plt.subplots(
        2, 1, sharex=True, figsize=(12, 7), layout=ConstrainedLayoutEngine(rect=(0, 0, 1, 0.905))
    )
    try:
        figure.text(0.012, 0.955, TITLE, fontsize=15, weight="bold")
        found = f"{report.pairs} of {report.pairs_possible} pairs, {report.wrong} wrong, {report.lost} lost"
        figure.text(0.012, 0.915, found, fontsize=10.5, color=FAINT)
        at, took = ([one[place] for one in report.puts] for place in (0, 1))
        puts.plot([one / NANOS_PER_SECOND for one in at], [one / NANOS_PER_MS for one in took], ".", color=BLUE)
        puts.set(yscale="log", ylabel="a put took, ms")
        at, disparities = ([one[place] for one in report.measured] for place in (0, 1))
        pairs.plot([one / NANOS_PER_SECOND for one in at], disparities, ".", color=ORANGE)
        pairs.set(
            xlabel="time of the frames, seconds", ylabel="disparity of each pair, pixels", xlim=(0, report.seconds)
        )
        for lane in (puts, pairs):
            _mark_events(lane, report, named=lane is puts)
        figure.text(0.995, 0.003, ATTRIBUTION, ha="right", fontsize=7, color=FAINT)
        figure.savefig(path, dpi=130)
    finally:
        plt.close(figure)


def _mark_events(lane: Axes, report: RoverReport, *, named: bool) -> None:
    lane.spines[["top", "right"]].set_visible(False)
    for number, (at, what) in enumerate(report.events):
        lane.axvline(at / NANOS_PER_SECOND, color=FAINT, linestyle="--", linewidth=1)
        if named:
            height = 0.98 - 0.08 * number
            lane.text(
                at / NANOS_PER_SECOND, height, f" {what}", transform=lane.get_xaxis_transform(), va="top",
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
            )  # fmt: skip
