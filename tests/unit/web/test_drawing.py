"""Unit tests of `stampede_rt_web.drawing`: items or density, marks, and bounds that do not depend on the items."""

from __future__ import annotations

import json

from hypothesis import given, strategies

from stampede_rt_web.drawing import Window, draw
from stampede_rt_web.track import ABSENT, ItemTrack, TrackItem


def track_of(*items: TrackItem) -> ItemTrack:
    track = ItemTrack()
    track.extend(items)
    return track


def test_few_items_are_drawn_one_by_one_in_microseconds() -> None:
    track = track_of(TrackItem(1_000_000, 500_000, 1, 7), TrackItem(2_000_000, ABSENT, 2, 8))
    drawing = draw(track, Window(start=0, end=3_000_000, width=300))
    assert drawing["items"] == [[1000.0, 1500.0, 1, 7], [2000.0, None, 2, 8]]
    assert drawing["count"] == 2


def test_a_later_item_ends_a_span_unless_the_channel_lets_spans_overlap() -> None:
    track = track_of(TrackItem(0, 9_000_000, 1, 0), TrackItem(2_000_000, ABSENT, 2, 0))
    window = Window(start=0, end=10_000_000, width=100)
    assert draw(track, window)["items"][0][1] == 2000.0
    assert draw(track, window, overlap_nanos=5_000_000)["items"][0][1] == 5000.0


def test_the_item_before_the_window_is_drawn_because_its_span_may_reach_into_it() -> None:
    track = track_of(TrackItem(1_000, ABSENT, 1, 0), TrackItem(5_000, 10_000, 2, 0))
    drawing = draw(track, Window(start=8_000, end=20_000, width=100))
    assert [one[2] for one in drawing["items"]] == [2]
    assert drawing["count"] == 0


def test_many_items_are_drawn_as_their_number_in_each_pixel() -> None:
    track = track_of(*(TrackItem(n * 10, ABSENT, n, 0) for n in range(1, 1001)))
    drawing = draw(track, Window(start=0, end=10_001, width=100))
    assert "items" not in drawing
    assert len(drawing["density"]) == 100
    assert sum(drawing["density"]) == 1000


@given(
    strategies.lists(strategies.integers(0, 10_000), max_size=300),
    strategies.integers(0, 9_999),
    strategies.integers(1, 400),
)
def test_every_item_of_the_window_is_drawn_once_and_the_drawing_is_small(
    times: list[int], start: int, width: int
) -> None:
    track = track_of(*(TrackItem(time, ABSENT, seq, 0) for seq, time in enumerate(sorted(times), start=1)))
    drawing = draw(track, Window(start=start, end=10_001, width=width))
    inside = [time for time in times if time >= start]
    assert drawing["count"] == len(inside)
    drawn = sum(drawing["density"]) if "density" in drawing else sum(1 for one in drawing["items"] if one[0] >= 0)
    assert drawn == len(inside)
    assert len(json.dumps(drawing)) < 200 + 60 * width
