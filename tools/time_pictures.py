"""Draws the pictures of docs/time-model.md from real channels: `.venv/bin/python tools/time_pictures.py [ADDRESS]`.

Without an address it starts a cluster. The drawn items were put into channels and read back from them. Colour-blind
readers can distinguish the colours, and a reader who sees no colours gets the same information.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster

MS, SECOND = 10**6, 10**9
BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"
PALE = {BLUE: "#cfe3f1", ORANGE: "#fbe8c3", GREEN: "#cbe9df"}
INK, FAINT, BAND = "#222222", "#767676", "#eef2f6"
WIDTH_INCHES, DOTS_PER_INCH = 11.0, 150
LANE, HEIGHT = 1.0, 0.56
READ_SECONDS = 10.0
HOLDS_S = 0.004  # the drawn width of a span of zero length, so that it is visible
IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"


@dataclass(frozen=True)
class DrawnItem:
    """One item on its lane, in seconds since the beginning.

    If `end_s` is None, the span lasts up to now. `row`: the number of items of its bucket above it. `visible`: a reader
    through the group got the item.
    """

    start_s: float
    end_s: float | None
    text: str
    row: int = 0
    visible: bool = True


@dataclass(frozen=True)
class Lane:
    """The items of one channel, and how to draw them."""

    label: str
    colour: str
    items: Sequence[DrawnItem]


@dataclass(frozen=True)
class Picture:
    """The content of a picture. `cut_s`: the time of a group's cut."""

    title: str
    subtitle: str
    lanes: Sequence[Lane]
    now_s: float
    start_s: float
    end_s: float
    window_s: tuple[float, float, str] | None = None
    cut_s: float | None = None


def drawn(
    items: Sequence[st.Item], base: int, texts: bool = True, shown: Sequence[st.Item] | None = None
) -> list[DrawnItem]:
    """Return the drawing of items in the order of the read. Items of one time are below each other.

    `shown`: the items that a group shows.
    """
    visible = {item.seq for item in (items if shown is None else shown)}
    found: list[DrawnItem] = []
    for item in items:
        row = sum(one.start_s == (item.time - base) / SECOND for one in found)
        end_s = None if item.end is None else (item.end - base) / SECOND
        text = (item.payload or b"").decode() if texts else ""
        found.append(DrawnItem((item.time - base) / SECOND, end_s, text, row, item.seq in visible))
    return found


def spans(rt: st.Connection) -> Picture:
    """Put items with every kind of span, and read them back."""
    channel = rt.channel(f"pictures/spans-{st.now()}", max_age="60s")
    base = st.now() - 10 * SECOND
    channel.put(b"a", time=base)
    channel.put(b"b", time=base + 2_400 * MS, duration="800ms")
    channel.put(b"c", time=base + 4_000 * MS)
    channel.put(b"d", time=base + 4_000 * MS, duration="700ms")
    channel.put(b"e", time=base + 5_800 * MS, duration="0s")
    channel.put(b"f", time=base + 6_900 * MS)
    now = base + 9 * SECOND
    before = drawn(channel.get(st.OLDEST, now), base)
    channel.put(b"late", time=base + 1_300 * MS)
    after = drawn(channel.get(st.OLDEST, now), base)
    found = [one.text for one in drawn(channel.get(base + 2_800 * MS, base + 4_300 * MS), base)]
    return Picture(
        "The span of each item: the time for which it is valid",
        "a, c, f: no duration, until the next item or up to now.  b, d: until their duration is over, if nothing comes "
        "before.  e: no time at all",
        [Lane("before a\nlate item", BLUE, before), Lane("after it", ORANGE, after)],
        now_s=9.0,
        start_s=-0.3,
        end_s=9.9,
        window_s=(2.8, 4.3, f"get(2.8 s, 4.3 s): {', '.join(found)}"),
    )


def figure_3(rt: st.Connection) -> Picture:
    """The paper's Figure 3: text of one second, and audio of 125 ms that has run ahead of it."""
    text = rt.channel(f"pictures/text-{st.now()}", max_age="60s")
    audio = rt.channel(f"pictures/audio-{st.now()}", max_age="60s")
    base = st.now() - 10 * SECOND
    for second, word in enumerate((b"I'm", b"late,", b"I'm late")):
        text.put(word, time=base + second * SECOND, duration="1s")
    for block in range(28):
        audio.put(b"%d" % block, time=base + block * 125 * MS, duration="125ms")
    group = rt.group(f"pictures/figure-3-{st.now()}", [text, audio], reference=text, bound="end")
    now = base + 3_500 * MS
    texts, blocks = (group[one].get(base, now, match="start", timeout=READ_SECONDS) for one in (text, audio))
    assert blocks.cut is not None
    return Picture(
        "What text and audio show together (the paper's Figure 3)",
        "shaded: the items that a reader of the group gets. The reference is the text, and the bound is the end of its "
        "newest item",
        [
            Lane("text\n1 s", ORANGE, drawn(text.get(st.OLDEST, now), base, shown=texts)),
            Lane("audio\n125 ms", GREEN, drawn(audio.get(st.OLDEST, now), base, texts=False, shown=blocks)),
        ],
        now_s=3.5,
        start_s=-0.12,
        end_s=3.85,
        cut_s=(blocks.cut - base) / SECOND,
    )


def draw(picture: Picture, path: Path) -> None:
    """Draw the picture as a PNG at `path`."""
    matplotlib.rcParams.update({"font.family": "DejaVu Sans", "font.size": 10, "text.color": INK})
    figure, axes = _figure(picture)
    if picture.window_s is not None:
        _draw_window(axes, picture, *picture.window_s)
    for place, lane in enumerate(picture.lanes):
        _draw_lane(axes, picture, lane, _top(picture, place))
    _draw_instant(axes, picture, picture.now_s, "now", INK, "-")
    if picture.cut_s is not None:
        _draw_instant(axes, picture, picture.cut_s, "cut", FAINT, "--")
    figure.savefig(path, dpi=DOTS_PER_INCH, facecolor="white")
    plt.close(figure)


def _figure(picture: Picture) -> tuple[Figure, Axes]:
    lanes = len(picture.lanes)
    height = 1.75 + 0.95 * lanes
    figure = plt.figure(figsize=(WIDTH_INCHES, height))
    axes = figure.add_axes((0.095, 0.5 / height, 0.885, 1 - 1.55 / height))
    figure.text(0.095, 1 - 0.36 / height, picture.title, fontsize=15, fontweight="bold", va="center")
    figure.text(0.095, 1 - 0.68 / height, picture.subtitle, fontsize=10, color=FAINT, va="center")
    axes.set_xlim(picture.start_s, picture.end_s)
    axes.set_ylim(0, lanes * LANE + 0.12)
    axes.set_yticks([])
    axes.set_xticks(range(int(picture.end_s) + 1), [f"{second} s" for second in range(int(picture.end_s) + 1)])
    axes.tick_params(length=4, colors=INK)
    for side in ("top", "left", "right"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(FAINT)
    return figure, axes


def _top(picture: Picture, place: int) -> float:
    return (len(picture.lanes) - place) * LANE - 0.14


def _draw_lane(axes: Axes, picture: Picture, lane: Lane, top: float) -> None:
    axes.text(-0.012, top - HEIGHT / 2, lane.label, transform=_left_of(axes), ha="right", va="center", linespacing=1.35)
    buckets = {item.start_s for item in lane.items if item.row}
    for item in lane.items:
        rows = 2 if item.start_s in buckets else 1
        _draw_item(axes, picture, lane.colour, item, top, HEIGHT / rows)


def _draw_item(axes: Axes, picture: Picture, colour: str, item: DrawnItem, top: float, height: float) -> None:
    """Draw a box with a mark at its beginning. If the span has no end yet, the box ends at now, with three dots."""
    end_s = picture.now_s if item.end_s is None else item.end_s
    low = top - height * (item.row + 1)
    visible = item.visible
    width = max(end_s - item.start_s, HOLDS_S)
    face = PALE[colour] if visible else "white"
    gap = 0.012 * (picture.end_s - picture.start_s) / 10
    axes.add_patch(
        FancyBboxPatch(
            (item.start_s + gap, low + 0.02), max(width - 2 * gap, HOLDS_S), height - 0.04,
            boxstyle="square,pad=0", facecolor=face, edgecolor=colour if visible else FAINT,
            linewidth=0.9, linestyle="-" if visible else (0, (2, 2)), zorder=3,
        )
    )  # fmt: skip
    axes.plot([item.start_s + gap] * 2, [low + 0.02, low + height - 0.02], color=colour if visible else FAINT,
              linewidth=3.2 if width > 0.3 or width <= HOLDS_S else 2.0, solid_capstyle="butt", zorder=4)  # fmt: skip
    if item.end_s is None:  # the span has no end yet
        axes.text(end_s - 0.06, low + height / 2, "...", ha="right", va="center", color=FAINT, zorder=5)
    if item.text:
        _draw_text(axes, item, width, low + height / 2)


def _draw_text(axes: Axes, item: DrawnItem, width: float, middle: float) -> None:
    narrow = width <= HOLDS_S
    place = item.start_s + (0.09 if narrow else width / 2)
    axes.text(place, middle, item.text, ha="left" if narrow else "center", va="center", fontweight="bold", zorder=5)


def _draw_window(axes: Axes, picture: Picture, start_s: float, end_s: float, text: str) -> None:
    top = len(picture.lanes) * LANE + 0.12
    axes.axvspan(start_s, end_s, color=BAND, zorder=0)
    for edge in (start_s, end_s):
        axes.axvline(edge, color=FAINT, linewidth=0.8, linestyle=(0, (3, 3)), zorder=1)
    axes.text((start_s + end_s) / 2, top + 0.05, text, ha="center", va="bottom", color=INK, fontsize=9.5)


def _draw_instant(axes: Axes, picture: Picture, instant_s: float, name: str, colour: str, style: str) -> None:
    axes.axvline(instant_s, color=colour, linewidth=1.3, linestyle=style, zorder=6)
    top = len(picture.lanes) * LANE + 0.12
    axes.text(instant_s, top + 0.05, name, ha="center", va="bottom", color=colour, fontweight="bold")


def _left_of(axes: Axes) -> object:
    """Return a transform: horizontally in parts of the width of the axes, vertically in data units."""
    return axes.get_yaxis_transform()


def draw_all(address: str, folder: Path) -> list[Path]:
    """Draw both pictures, from channels of the cluster at `address`."""
    with st.connect(address) as rt:
        pictures = {"time-spans.png": spans(rt), "time-figure-3.png": figure_3(rt)}
    for name, picture in pictures.items():
        draw(picture, folder / name)
    return [folder / name for name in pictures]


def main() -> None:
    """Draw into docs/images."""
    if len(sys.argv) > 1:
        draw_all(sys.argv[1], IMAGES)
        return
    with LocalCluster(hosts=1, supernodes=1) as cluster:
        os.environ["STAMPEDE_SECRET_FILE"] = str(cluster.secret_file)
        draw_all(cluster.address, IMAGES)


if __name__ == "__main__":
    main()
