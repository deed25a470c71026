"""Draws the items of the streams on one time line, and marks the synchronised intervals.

Colours are from the Okabe-Ito palette, which colour-blind readers can distinguish. A reader who sees no colours gets
the same information.
"""

from __future__ import annotations

import io
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from PIL import Image, ImageColor

from stampede_rt_demos.staging.film import ATTRIBUTION
from stampede_rt_demos.staging.schedule import NANOS_PER_SECOND
from stampede_rt_demos.tv_watcher.picture_data import PictureSpan

BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PALE_BLUE, PALE_ORANGE = "#b8d5e8", "#f8e2b3"
INK, FAINT, BAND = "#222222", "#767676", "#eef2f6"
DRAWING_COLOURS = ("#ffffff", BAND, INK, FAINT, BLUE, PALE_BLUE, ORANGE, PALE_ORANGE, GREEN, VERMILION)
TITLE = "One caption, and everything that is in its span"
WIDTH_INCHES, HEIGHT_INCHES, DOTS_PER_INCH = 12.0, 6.0, 150
LEFT, RIGHT, TOP, BOTTOM = 0.1, 0.955, 0.87, 0.085
CAPTION_CHARS = 23
LOUDNESS_FLOOR_DBFS = -60
PHOTO_COLOURS = 224  # a PNG with a palette has 256 colours; the drawing uses the others
_LANES = {
    "brackets": 0.3,
    "video": 0.97,
    "frames": 0.22,
    "motion": 0.7,
    "sound": 0.75,
    "loudness": 0.7,
    "captions": 0.85,
}
_LABELS = {
    "video": "video\nJPEG, 25 per s",
    "motion": "motion\nfrom video",
    "sound": "audio\nPCM, 125 ms",
    "loudness": "loudness, dBFS\nfrom audio",
    "captions": "captions\n1 s",
}


def draw(spans: Sequence[PictureSpan], path: Path, subtitle: str) -> None:
    """Draw the spans into a PNG at `path`. Uses about 30 MB until it returns.

    `subtitle` has the measured figures. Raises ValueError if there is nothing to draw, OSError if the file cannot be
    written.
    """
    if not spans:
        raise ValueError("the viewer got no caption with its frames, so there is nothing to draw; run for longer")
    matplotlib.rcParams.update({"font.family": "DejaVu Sans", "font.size": 9.5, "text.color": INK})
    figure, lanes = _figure(spans, subtitle)
    try:
        _draw_brackets(lanes["brackets"], spans)
        _draw_video(lanes["video"], lanes["frames"], spans)
        _draw_motion(lanes["motion"], spans)
        _draw_sound(lanes["sound"], spans)
        _draw_loudness(lanes["loudness"], spans)
        _draw_captions(lanes["captions"], spans)
        _save(figure, path)
    finally:
        plt.close(figure)


def _figure(spans: Sequence[PictureSpan], subtitle: str) -> tuple[Figure, dict[str, Axes]]:
    """Return the empty lanes over a common time axis, with titles and background."""
    figure, axes = plt.subplots(
        len(_LANES),
        1,
        sharex=True,
        figsize=(WIDTH_INCHES, HEIGHT_INCHES),
        dpi=DOTS_PER_INCH,
        gridspec_kw={"height_ratios": list(_LANES.values()), "hspace": 0.13},
    )
    figure.subplots_adjust(left=LEFT, right=RIGHT, top=TOP, bottom=BOTTOM)
    lanes = dict(zip(_LANES, axes, strict=True))
    for name, lane in lanes.items():
        _make_bare(lane, _LABELS.get(name, ""))
    _label_time(figure, lanes["captions"], spans)
    _draw_background(figure, spans)
    figure.text(LEFT, 0.945, TITLE, fontsize=15, weight="bold")
    figure.text(LEFT, 0.9, subtitle, fontsize=10.5, color=FAINT)
    return figure, lanes


def _make_bare(lane: Axes, label: str) -> None:
    """Remove the frame and the ticks of a lane.

    The label is at the left, and the scale, if there is one, at the right.
    """
    lane.set_ylabel(label, rotation=0, ha="right", va="center", labelpad=8, color=INK)
    lane.patch.set_visible(False)
    lane.yaxis.tick_right()
    lane.set_yticks([])
    lane.tick_params(axis="x", length=0, labelbottom=False)
    lane.tick_params(axis="y", length=0, labelsize=8, labelcolor=FAINT)
    for side in lane.spines.values():
        side.set_visible(False)


def _label_time(figure: Figure, lowest: Axes, spans: Sequence[PictureSpan]) -> None:
    lowest.set_xlim(_seconds(spans[0].start), _seconds(spans[-1].end))
    lowest.xaxis.set_major_locator(matplotlib.ticker.MultipleLocator(1))
    lowest.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%d s"))
    lowest.tick_params(axis="x", length=4, labelbottom=True, labelcolor=INK)
    figure.text(RIGHT, 0.012, f"Film: {ATTRIBUTION}", ha="right", fontsize=8, color=FAINT)


def _draw_background(figure: Figure, spans: Sequence[PictureSpan]) -> None:
    """Draw the intervals through all lanes: every second one shaded, with a line between two of them."""
    behind = figure.add_axes((LEFT, BOTTOM, RIGHT - LEFT, TOP - BOTTOM), zorder=-1)
    behind.set_axis_off()
    behind.set_xlim(_seconds(spans[0].start), _seconds(spans[-1].end))
    for number, span in enumerate(spans):
        if number % 2 == 0:
            behind.axvspan(_seconds(span.start), _seconds(span.end), color=BAND, lw=0)
        behind.axvline(_seconds(span.start), color=FAINT, lw=0.8, ls=(0, (4, 3)))


def _draw_brackets(lane: Axes, spans: Sequence[PictureSpan]) -> None:
    """Draw a bracket over each synchronised interval, with the number of its items."""
    lane.set_ylim(0, 1)
    for span in spans:
        start, end = _seconds(span.start) + 0.015, _seconds(span.end) - 0.015
        lane.plot([start, start, end, end], [0.02, 0.25, 0.25, 0.02], color=INK, lw=1.3, solid_capstyle="butt")
        counts = f"{len(span.frames)} frames, {len(span.sound)} blocks"
        lane.text((start + end) / 2, 0.45, counts, ha="center", va="bottom", weight="bold")


def _draw_video(lane: Axes, marks: Axes, spans: Sequence[PictureSpan]) -> None:
    """Draw the middle frame of each span. Below it is a mark for every frame, a thick one for the shown frame."""
    for span in spans:
        time, jpeg = span.thumbnail
        with Image.open(io.BytesIO(jpeg)) as image:
            pixels = np.asarray(image)
        edges = (_seconds(span.start) + 0.015, _seconds(span.end) - 0.015, 0.0, 1.0)
        lane.imshow(pixels, extent=edges, aspect="auto", zorder=3)
        marks.vlines([_seconds(frame) for frame in span.frames], 0, 0.8, color=BLUE, lw=1.4)
        marks.vlines(_seconds(time), 0, 1.25, color=BLUE, lw=3, clip_on=False)
    lane.set_ylim(0, 1)
    marks.set_ylim(0, 1)


def _draw_motion(lane: Axes, spans: Sequence[PictureSpan]) -> None:
    """Draw the energy as steps, on a root scale, so that small motion is visible next to a cut. Name the cuts."""
    points = [point for span in spans for point in span.motion]
    times = [*(_seconds(time) for time, _, _ in points), _seconds(spans[-1].end)]
    heights = np.sqrt([energy for _, energy, _ in [*points, *points[-1:]]])
    top = max(0.16, float(heights.max(initial=0)))
    lane.fill_between(times[: len(heights)], heights, step="post", color=PALE_BLUE, lw=0)
    lane.step(times[: len(heights)], heights, where="post", color=BLUE, lw=1.4)
    for time, energy, cut in points:
        if cut:
            at = (_seconds(time), energy**0.5)
            lane.annotate("cut", at, (-7, -6), textcoords="offset points", ha="right", color=VERMILION, weight="bold")
            lane.plot(*at, marker="v", color=VERMILION, ms=7, clip_on=False)
    _set_scale(lane, 0, top)
    lane.set_yticklabels(["0", f"{top**2:.2f}"])


def _draw_sound(lane: Axes, spans: Sequence[PictureSpan]) -> None:
    """Draw the envelope of the wave, with a thin line between two blocks."""
    blocks = [block for span in spans for block in span.sound]
    peak = max((abs(value) for _, _, envelope in blocks for pair in envelope for value in pair), default=0.0) or 1.0
    for time, duration, envelope in blocks:
        edges = np.linspace(_seconds(time), _seconds(time + duration), len(envelope) + 1)
        low, high = np.array(envelope).T
        lane.fill_between(edges, [*low, low[-1]], [*high, high[-1]], step="post", color=GREEN, lw=0.4)
        lane.vlines(_seconds(time), -peak, peak, color=GREEN, lw=0.7, alpha=0.6)
    _set_scale(lane, -peak, peak, ".2f")


def _draw_loudness(lane: Axes, spans: Sequence[PictureSpan]) -> None:
    """Draw one step for each block, from its beginning to its end."""
    levels = [level for span in spans for level in span.loudness]
    heights = [max(dbfs, LOUDNESS_FLOOR_DBFS) for _, _, dbfs in levels]
    starts = [_seconds(time) for time, _, _ in levels]
    ends = [_seconds(time + duration) for time, duration, _ in levels]
    floor, top = LOUDNESS_FLOOR_DBFS, min(0, 10 * math.ceil((max(heights, default=0) + 3) / 10))
    lane.bar(starts, np.subtract(heights, floor), np.subtract(ends, starts), floor, align="edge", color=PALE_ORANGE)
    lane.hlines(heights, starts, ends, color=ORANGE, lw=2.6)
    _set_scale(lane, floor, top, "d")


def _draw_captions(lane: Axes, spans: Sequence[PictureSpan]) -> None:
    """Draw a box over each caption's span, with the clip's timecode above and the text below."""
    lane.set_ylim(0, 1)
    for span in spans:
        left, width = _seconds(span.start) + 0.015, _seconds(span.end - span.start) - 0.03
        box = FancyBboxPatch((left, 0.06), width, 0.9, boxstyle="round,pad=0,rounding_size=0.03", fc="white", ec=INK)
        lane.add_patch(box)
        code, _, text = span.text.partition(" ")
        middle = left + width / 2
        lane.text(middle, 0.84, code, ha="center", va="center", fontsize=8, color=FAINT, family="DejaVu Sans Mono")
        wrapped = textwrap.fill(text, CAPTION_CHARS)
        lane.text(middle, 0.41, wrapped, ha="center", va="center", fontsize=9, linespacing=1.2)


def _set_scale(lane: Axes, low: float, high: float, style: str = "g") -> None:
    """Set the scale of the lane from `low` to `high`, and write both at its right."""
    lane.set_ylim(low, high)
    lane.set_yticks([low, high], [f"{low:{style}}", f"{high:{style}}"])
    lowest, highest = lane.get_yticklabels()
    lowest.set_verticalalignment("bottom")
    highest.set_verticalalignment("top")


def _save(figure: Figure, path: Path) -> None:
    """Save a PNG with a palette, a third of the size. The colours of the drawing stay exact, but the colours of photos
    do not."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    with Image.open(drawn) as opened:
        image = opened.convert("RGB")
    quantised = image.quantize(PHOTO_COLOURS)
    palette, indexes, pixels = quantised.getpalette() or [], np.array(quantised), np.asarray(image)
    for number, colour in enumerate(DRAWING_COLOURS, start=PHOTO_COLOURS):
        palette[3 * number :] = ImageColor.getrgb(colour)
        indexes[(pixels == palette[-3:]).all(axis=2)] = number
    exact = Image.fromarray(indexes)
    exact.putpalette(palette)
    exact.save(path, "PNG", optimize=True)


def _seconds(nanos: int) -> float:
    return nanos / NANOS_PER_SECOND
