"""The keys of `stampede top`."""

from __future__ import annotations

from stampede_rt.cli.channel_rates import SORTS
from stampede_rt.cli.top import TopView
from stampede_rt.cli.top_columns import COLUMN_NAMES, GAP, WIDTHS, fitting_columns


def pressed(keys: str) -> TopView:
    view = TopView("bytes")
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


def test_a_narrower_terminal_shows_fewer_columns_and_at_least_half_of_each_name_or_32_characters() -> None:
    former: set[str] = set()
    for terminal in range(24, 200):
        heads = fitting_columns(terminal, longest_name=60)
        assert set(heads) >= former
        used = sum(GAP + WIDTHS[head] for head in heads)
        assert terminal - used >= min(32, terminal // 2)
        former = set(heads)
    assert fitting_columns(200, 60) == COLUMN_NAMES
    assert fitting_columns(50, 10) == ("ITEMS/S", "IN/S", "AGE")
    assert fitting_columns(40, 60) == ("ITEMS/S",)


def test_short_names_leave_room_for_more_columns() -> None:
    assert len(fitting_columns(100, 8)) > len(fitting_columns(100, 40))
