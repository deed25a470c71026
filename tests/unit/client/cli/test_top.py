"""The keys of `stampede top`."""

from __future__ import annotations

from stampede_rt.cli.channel_rates import SORTS
from stampede_rt.cli.top import View


def pressed(keys: str) -> View:
    view = View("bytes")
    for key in keys:
        view.press(key)
    return view


def test_keys_sort_pause_and_quit() -> None:
    assert pressed("s").sort == SORTS[1]
    assert pressed("s" * len(SORTS)).sort == "bytes"
    assert pressed("p").is_paused
    assert not pressed("pp").is_paused
    assert pressed("q").is_over


def test_a_filter_is_typed_erased_kept_and_cleared() -> None:
    view = pressed("/camq\x7f\n")
    assert (view.filter, view.is_typing, view.is_over) == ("cam", False, False)
    assert pressed("/cam\x1b").filter == ""
    assert pressed("/a\x00\x07b").filter == "ab"
