"""Matches of keys, for readers of archives."""

from __future__ import annotations

import pytest

from stampede_rt.matching.key_matcher import KeyMatch, KeyMatcher, has_passed

OWN, OTHER = b"own", b"other"


def matcher(*, unique: bool = False, low: int = 0) -> KeyMatcher:
    return KeyMatcher(OWN, [OTHER], 3, (low, 0), unique=unique)


def passed(reach: int):
    return lambda channel_id, instant: instant <= reach


def test_a_match_waits_until_no_nearer_key_can_come() -> None:
    made = matcher()
    made.add(OWN, [(10, 1)])
    made.add(OTHER, [(8, 1)])
    assert made.take(passed(12)) is None
    made.add(OTHER, [(11, 2)])
    assert made.take(passed(13)) == KeyMatch((10, 1), {OTHER: (11, 2)})
    assert made.take(passed(99)) is None


@pytest.mark.parametrize(("unique", "second"), [(False, {OTHER: (11, 1)}), (True, {})])
def test_a_unique_key_goes_into_one_match(unique: bool, second: dict[bytes, tuple[int, int]]) -> None:
    made = matcher(unique=unique)
    made.add(OWN, [(11, 1), (12, 2)])
    made.add(OTHER, [(11, 1)])
    assert made.take(passed(99)) == KeyMatch((11, 1), {OTHER: (11, 1)})
    assert made.take(passed(99)) == KeyMatch((12, 2), second)


def test_keys_before_the_next_decided_one_are_too_late_and_old_keys_are_dropped() -> None:
    made = matcher(low=5)
    assert made.add(OWN, [(4, 1), (7, 2)]) == 1
    assert made.add(OTHER, [(1, 1), (6, 2)]) == 0
    assert made.next_time == 7
    assert made.take(passed(99)) == KeyMatch((7, 2), {OTHER: (6, 2)})
    assert made.add(OWN, [(7, 1)]) == 1
    assert len(made) == 2


def test_a_channel_has_passed_an_instant_after_an_item_or_advance_beyond_it() -> None:
    assert has_passed(10, None, 10, 0)
    assert not has_passed(10, None, 10, 1)
    assert not has_passed(12, None, 10, 2)
    assert has_passed(13, None, 10, 2)
    assert has_passed(None, 11, 10, 5)
    assert not has_passed(None, 10, 10, 0)
