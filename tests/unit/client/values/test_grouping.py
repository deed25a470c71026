"""Values of groups: possible members, and the search of values by channel."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.grouping import (
    MEMBERS_MAX,
    ByChannel,
    SeenCut,
    parse_group_bound,
    parse_members,
    parse_reference,
    parse_tolerance,
)


@dataclass(frozen=True)
class Info:
    name: str
    channel_id: bytes


@dataclass(frozen=True)
class Handle:
    info: Any


def handle(name: str) -> Handle:
    return Handle(Info(name, name.encode()))


@dataclass
class Pair:
    left: Handle = field(default_factory=lambda: handle("left"))
    right: Handle = field(default_factory=lambda: handle("right"))


def test_values_are_found_by_handle_by_another_handle_of_the_same_channel_and_by_name() -> None:
    pair = Pair()
    found = ByChannel([pair.left, pair.right], {b"left": 1, b"right": 2})
    assert (found[pair.left], found[handle("right")], found["left"]) == (1, 2, 1)
    assert dict(found) == {pair.left: 1, pair.right: 2}
    assert repr(found) == "{'left': 1, 'right': 2}"


def test_a_mapping_has_no_key_for_a_channel_without_a_value_or_for_another_object() -> None:
    pair = Pair()
    found = ByChannel([pair.left, pair.right], {b"left": 1})
    assert list(found) == [pair.left]
    stranger: Any = 7
    for absent in (pair.right, "right", stranger):
        assert absent not in found
        with pytest.raises(KeyError):
            found[absent]


def test_a_reader_never_forgets_the_highest_cut_that_it_saw() -> None:
    view = SeenCut(b"group")
    for cut in (None, 5, 9, 7, None):
        view.note_cut(cut)
    assert view.cut_floor == 9


@pytest.mark.parametrize(
    ("channels", "complaint"),
    [
        ([], "1 to 64 channels, not 0"),
        ([handle(str(number)) for number in range(MEMBERS_MAX + 1)], "not 65"),
        ([handle("left"), handle("left")], "left is in the list twice"),
        ([handle("left"), "right"], "'right' is not a channel"),
        ("left", "give a list"),
        (handle("left"), "give a list"),
    ],
)
def test_impossible_members_of_a_group_are_refused_with_the_reason(channels: Any, complaint: str) -> None:
    with pytest.raises(InvalidArgument, match=complaint):
        parse_members(channels)


def test_a_list_of_the_greatest_number_of_members_is_accepted_unchanged() -> None:
    channels = [handle(str(number)) for number in range(MEMBERS_MAX)]
    assert parse_members(channels) == channels


def test_the_reference_is_a_member_by_handle_or_name_or_the_oldest_of_all() -> None:
    pair = Pair()
    members = [pair.left, pair.right]
    assert parse_reference("oldest", members) is None
    assert parse_reference("right", members) == b"right"
    assert parse_reference(handle("left"), members) == b"left"


@pytest.mark.parametrize("reference", ["middle", handle("middle"), None, 7])
def test_a_reference_that_is_no_member_is_refused(reference: Any) -> None:
    with pytest.raises(InvalidArgument, match='name one of its channels, or "oldest"'):
        parse_reference(reference, [handle("left")])


def test_bounds_and_tolerances_are_checked() -> None:
    assert parse_group_bound("end") == "end"
    with pytest.raises(InvalidArgument, match="'middle'"):
        parse_group_bound("middle")
    assert parse_tolerance("10ms") == 10_000_000
    with pytest.raises(InvalidArgument, match="tolerance"):
        parse_tolerance("-1ms")
