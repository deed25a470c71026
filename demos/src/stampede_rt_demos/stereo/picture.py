"""Draws the picture of the stereo demo: the last pair, and the measured and the true disparity over time.

Colours are from the Okabe-Ito palette. A reader who sees no colours gets the same information.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

from stampede_rt_demos.staging.film import ATTRIBUTION
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.stereo.programme import DISPARITY_MAX, Side
from stampede_rt_demos.stereo.report import StereoReport, subtitle

BLUE, ORANGE, GREEN, INK, FAINT = "#0072B2", "#E69F00", "#009E73", "#222222", "#767676"
TITLE = "Two cameras, paired by time: disparity of every pair"
BELOW_TITLE = ConstrainedLayoutEngine(rect=(0, 0, 1, 0.905))


def draw(report: StereoReport, frames: Sequence[bytes], frame_nanos: int, path: Path) -> None:
    """Draw a PNG at `path`. Raises ValueError if there was no pair, OSError if the file cannot be written."""
    if len(frames) != 2 or not report.measured:
        raise ValueError("the consumer got no pair, so there is nothing to draw; run for longer")
    plt.rcParams.update({"font.family": "DejaVu Sans", "font.size": 9.5, "text.color": INK})
    figure, lanes = plt.subplot_mosaic(
        [["left", "right"], ["time", "time"]], figsize=(12, 7), height_ratios=(1, 1.1), layout=BELOW_TITLE
    )
    try:
        figure.text(0.012, 0.955, TITLE, fontsize=15, weight="bold")
        figure.text(0.012, 0.915, subtitle(report), fontsize=10.5, color=FAINT)
        for name, frame in zip(("left", "right"), frames, strict=True):
            _draw_frame(lanes[name], name, frame)
        _draw_disparity(lanes["time"], report, frame_nanos)
        figure.text(0.995, 0.003, ATTRIBUTION, ha="right", fontsize=7, color=FAINT)
        figure.savefig(path, dpi=130)
    finally:
        plt.close(figure)


def _draw_frame(lane: Axes, name: str, jpeg: bytes) -> None:
    with Image.open(io.BytesIO(jpeg)) as image:
        lane.imshow(np.asarray(image.convert("L")), cmap="gray")
    lane.set_title(f"{name} camera, the last pair", loc="left", fontsize=10.5)
    lane.set(xticks=[], yticks=[])


def _draw_disparity(lane: Axes, report: StereoReport, frame_nanos: int) -> None:
    seconds = np.array([at for at, _, _ in report.measured]) / NANOS_PER_SECOND
    lane.plot(seconds, [truth for _, _, truth in report.measured], color=ORANGE, linewidth=3, label="true")
    lane.plot(seconds, [one for _, one, _ in report.measured], ".", color=BLUE, markersize=4, label="measured")
    for side, mark, height in ((Side.LEFT, "v", 1.6), (Side.RIGHT, "^", 0.6)):
        at = [number * frame_nanos / NANOS_PER_SECOND for number in report.alone_reported[side]]
        label = f"{side.name.lower()} frame without a partner"
        lane.plot(at, [height] * len(at), mark, color=GREEN, markersize=6, label=label)
    lane.vlines(report.seconds / 2, 0, DISPARITY_MAX + 3, color=FAINT, linestyle="--", linewidth=1)
    lane.text(report.seconds / 2, DISPARITY_MAX + 1, " a second consumer joins", color=FAINT, va="bottom")
    lane.set(xlabel="seconds", ylabel="disparity, pixels", ylim=(0, DISPARITY_MAX + 8), xlim=(0, report.seconds))
    lane.spines[["top", "right"]].set_visible(False)
    lane.legend(frameon=False, loc="upper right", ncols=4)
