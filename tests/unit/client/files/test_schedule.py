"""The moment at which a replay puts each item, and the time of the item."""

from __future__ import annotations

from functools import partial

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.files.names import channel_name, matches_any
from stampede_rt.files.schedule import Schedule, parse_shift, parse_speed, target_policy
from stampede_rt.values.policy import FOREVER_NANOS

SECOND = 1_000_000_000
NOW = 1_700_000_000 * SECOND


@pytest.mark.parametrize("speed", [0.1, 0.5, 1, 2, 7.5, 0])
def test_a_shifted_item_is_never_ahead_of_the_clock_and_never_further_behind_than_the_lag(speed: float) -> None:
    plan = Schedule.plan(0, 60 * SECOND, speed, "now", NOW)
    for time in range(0, 61 * SECOND, SECOND):
        behind = NOW + plan.due_nanos(time) - plan.shifted(time)
        assert 0 <= behind <= plan.lag_nanos


def test_a_shift_keeps_the_distances_between_items() -> None:
    plan = Schedule.plan(5, 60 * SECOND, 3, "now", NOW)
    assert plan.shifted(20) - plan.shifted(7) == 13


def test_without_a_shift_times_are_unchanged_and_a_shift_adds_its_duration() -> None:
    assert Schedule.plan(0, 1, 1, None, NOW).shifted(7) == 7
    assert Schedule.plan(0, 1, 1, parse_shift("-1s"), NOW).shifted(7) == 7 - SECOND
    assert Schedule.plan(0, 1, 1, 2**63 - 2, NOW).shifted(7) == 2**63 - 1  # an advance after the last item


@pytest.mark.parametrize(("end", "shift"), [(2**64 - 1, None), (2**64 - 1, "now"), (1, 2**63 - 1), (1, -(2**63) - 1)])
def test_a_shift_to_times_that_no_channel_can_have_is_refused(end: int, shift: int | str | None) -> None:
    with pytest.raises(InvalidArgument, match="the items would get times from"):
        Schedule.plan(0, end, 0, shift, NOW)


@pytest.mark.parametrize("speed", [-1, True, "2", float("nan"), float("inf"), 1e9])
def test_an_impossible_speed_is_refused(speed: object) -> None:
    with pytest.raises(InvalidArgument):
        parse_speed(speed)


def test_a_new_channel_has_the_recorded_policy_and_keeps_late_times() -> None:
    recorded = {"max_age_nanos": 10 * SECOND, "max_items": 7, "consumers": 3, "on_full": "block", "content_type": "a/b"}
    assert target_policy(recorded, False, 0, keeps_all=False, archived=True) == {
        "max_items": 7, "max_bytes": 256 * 1024 * 1024, "content_type": "a/b",
    }  # fmt: skip
    assert target_policy(recorded, True, SECOND, keeps_all=False, archived=True)["max_age"] == f"{21 * SECOND} ns"


def test_a_new_channel_that_keeps_all_items_has_no_limit_of_their_number() -> None:
    found = target_policy({"max_items": 7, "max_bytes": 2**30}, False, 0, keeps_all=True, archived=True)
    assert (found["max_items"], found["max_bytes"]) == (None, 2**30)
    assert target_policy({"max_bytes": 9}, False, 0, keeps_all=True, archived=True)["max_bytes"] == 256 * 1024 * 1024


@pytest.mark.parametrize("shifted", [False, True])
def test_a_new_channel_takes_items_as_far_ahead_of_the_clock_as_the_recorded_one(shifted: bool) -> None:
    found = target_policy({"max_future_nanos": 9 * SECOND}, shifted, 0, keeps_all=True, archived=True)
    assert found["max_future"] == f"{9 * SECOND} ns"
    assert "max_future" not in target_policy({}, shifted, 0, keeps_all=True, archived=True)


def test_a_new_channel_has_the_recorded_archive_for_a_time_that_suits_the_times_of_its_items() -> None:
    recorded = {"max_items": 7, "archive_nanos": 5 * SECOND, "archive_bytes": 2**30}
    policy = partial(target_policy, recorded, keeps_all=True)
    unshifted, shifted = policy(False, 0, archived=True), policy(True, SECOND, archived=True)
    assert (unshifted["archive"], unshifted["archive_bytes"], unshifted["max_items"]) == ("forever", 2**30, 7)
    assert (shifted["archive"], shifted["archive_bytes"]) == (f"{16 * SECOND} ns", 2**30)
    assert "archive" not in policy(False, 0, archived=False)
    forever = target_policy({"archive_nanos": FOREVER_NANOS}, True, SECOND, keeps_all=True, archived=True)
    assert forever["archive"] == "forever"
    by_size = target_policy({"archive_bytes": 1}, False, 0, keeps_all=True, archived=True)
    assert (by_size["archive"], by_size["archive_bytes"]) == (None, 2**20)


@pytest.mark.parametrize(
    "hostile",
    [
        {"max_items": -1},
        {"archive_nanos": 2**63},
        {"archive_bytes": "1"},
        {"max_items": "7"},
        {"max_items": True},
        {"content_type": "é"},
        {"overlap_nanos": 2**70},
    ],
)
def test_an_invalid_recorded_policy_is_ignored(hostile: dict[str, object]) -> None:
    found = target_policy(hostile, True, 0, keeps_all=False, archived=True)
    assert {key: value for key, value in found.items() if value is not None} == {"max_bytes": 256 * 1024 * 1024}


@pytest.mark.parametrize(
    ("topic", "name"),
    [("/imu/data", "imu/data"), ("a b\x1b", "a_b_"), ("//", "unnamed"), ("x" * 200, "x" * 128), ("日本", "unnamed")],
)
def test_a_topic_becomes_a_name_that_a_channel_may_have(topic: str, name: str) -> None:
    assert channel_name(topic) == name
    assert len(channel_name(topic, "replay/")) <= 128


def test_only_stars_and_question_marks_are_wildcards() -> None:
    chosen = matches_any(["rig/*", "ca?", "[x]"])
    assert [name for name in ("rig/a/b", "cam", "came", "x", "[x]", "rig") if chosen(name)] == ["rig/a/b", "cam", "[x]"]
    assert matches_any(None)("anything")
    assert not matches_any(["*a*a*a*a*a*a*b"])("a" * 60)
