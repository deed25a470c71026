"""Unit tests of `stampede_rt_web.window_cache`: the windows of the past that pages showed last."""

from __future__ import annotations

from stampede_rt_web.drawing import Window, draw
from stampede_rt_web.track import ABSENT, ItemTrack, TrackItem
from stampede_rt_web.window_cache import REREAD_NANOS, WINDOWS_MAX, WindowCache


def window(start: int, width: int = 100) -> Window:
    return Window(start=start, end=start + 1_000_000, width=width)


def test_a_window_is_read_once_and_read_again_after_some_time() -> None:
    windows, track = WindowCache(), ItemTrack()
    assert windows.is_due(window(1), now=0)
    assert windows.track_of(window(1)) is None
    windows.keep(window(1), track, now=0)
    assert windows.track_of(window(1, width=50)) is track
    assert not windows.is_due(window(1), now=REREAD_NANOS - 1)
    assert windows.is_due(window(1), now=REREAD_NANOS)


def test_only_the_windows_that_were_read_last_are_kept() -> None:
    windows = WindowCache()
    for start in range(WINDOWS_MAX):
        windows.keep(window(start), ItemTrack(), now=start)
    windows.keep(window(0), ItemTrack(), now=WINDOWS_MAX)
    windows.keep(window(99), ItemTrack(), now=WINDOWS_MAX)
    assert windows.track_of(window(0)) is not None
    assert windows.track_of(window(1)) is None


def test_a_window_with_more_items_than_the_limit_names_the_end_of_the_read_part() -> None:
    track = ItemTrack()
    track.prepend([TrackItem(2_000, ABSENT, 1, 10), TrackItem(3_000, ABSENT, 2, 10)])
    assert "ends" not in draw(track, window(1_000))
    track.ends_early = True
    assert draw(track, window(1_000))["ends"] == 2.0
