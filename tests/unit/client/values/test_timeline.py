"""Instants, durations and intervals as a program states them."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, strategies

from stampede_rt.errors import InvalidArgument, InvalidInterval
from stampede_rt.values.timeline import (
    MAX_INSTANT,
    MIN_INSTANT,
    NEWEST,
    NOW,
    OLDEST,
    ResolvedInterval,
    format_duration,
    format_instant,
    last,
    parse_duration,
    parse_instant,
    parse_interval,
    parse_item_duration,
    parse_match,
)

instants = strategies.integers(MIN_INSTANT, MAX_INSTANT)


@pytest.mark.parametrize(
    ("text", "nanos"),
    [
        ("30ms", 30_000_000),
        ("1.5s", 1_500_000_000),
        ("1 us", 1_000),
        ("7ns", 7),
        ("2m", 120 * 10**9),
        ("-1h", -3600 * 10**9),
    ],
)
def test_durations_are_written_with_their_unit(text: str, nanos: int) -> None:
    assert parse_duration(text) == nanos


@pytest.mark.parametrize("wrong", [10, 1.0, "10", "ten s", "1.5ns", "", "1 week", None, True])
def test_a_duration_without_a_unit_is_refused(wrong: object) -> None:
    with pytest.raises(InvalidArgument, match="max_age"):
        parse_duration(wrong, "max_age")  # type: ignore[arg-type]


def test_a_timedelta_is_exact() -> None:
    assert parse_duration(timedelta(days=400, microseconds=1)) == 400 * 86_400 * 10**9 + 1_000


def test_an_items_duration_may_be_a_number_of_nanoseconds() -> None:
    assert parse_item_duration(33_000_000) == parse_item_duration("33ms") == 33_000_000
    assert parse_item_duration(None) is None


@pytest.mark.parametrize("wrong", [-1, "-1ms", 1.5, True, 2**63])
def test_an_items_duration_is_not_negative(wrong: object) -> None:
    with pytest.raises(InvalidArgument):
        parse_item_duration(wrong)  # type: ignore[arg-type]


def test_instants_are_ints_or_datetimes_with_a_timezone() -> None:
    assert parse_instant(5) == 5
    assert parse_instant(datetime(1970, 1, 1, 0, 0, 1, tzinfo=UTC)) == 10**9


@pytest.mark.parametrize("wrong", [1.5, "now", True, None, 2**63, datetime(2026, 1, 1)])
def test_a_value_that_loses_digits_or_needs_a_guess_is_not_parsed_as_an_instant(wrong: object) -> None:
    with pytest.raises(InvalidArgument):
        parse_instant(wrong)  # type: ignore[arg-type]


def test_the_error_for_a_wrong_bound_names_the_meta_times_and_the_error_for_a_wrong_time_does_not() -> None:
    with pytest.raises(InvalidArgument, match=r'timezone, or NOW, NEWEST or OLDEST, as in NOW - "5s"$'):
        parse_interval("5s", NOW)
    with pytest.raises(InvalidArgument, match=r"a time is '5s'; give int nanoseconds .* a datetime with a timezone$"):
        parse_instant("5s")  # type: ignore[arg-type]


def test_the_sum_of_offsets_is_shown_as_written() -> None:
    assert str(NEWEST - "30ms" - "20ms") == "newest - 50 ms"
    assert NOW - "1s" + "1s" == NOW
    assert last("30s") == (NOW - "30s", NOW)


@given(instants, instants)
def test_an_interval_whose_end_is_before_its_start_is_refused(a: int, b: int) -> None:
    low, high = sorted((a, b))
    assert parse_interval(low, high)
    if low != high:
        with pytest.raises(InvalidInterval, match=str(low)):
            parse_interval(high, low)


def test_all_meta_times_are_resolved_together() -> None:
    interval = parse_interval(OLDEST, NOW - "1ns", "(]")
    assert interval.resolve(now=100, newest=90, oldest=50) == ResolvedInterval(50, 99, True, False)
    assert interval.resolve(now=100, newest=None, oldest=None) is None


def test_an_interval_without_newest_and_oldest_is_resolved_before_the_first_item() -> None:
    assert parse_interval(0, NOW).resolve(now=7, newest=None, oldest=None) == ResolvedInterval(0, 7)


@given(instants, strategies.integers(-(2**62), 2**62))
def test_sums_stay_within_64_bits(instant: int, offset: int) -> None:
    bound = NOW + timedelta(microseconds=offset // 1000)
    resolved = parse_interval(bound, bound).resolve(now=instant, newest=None, oldest=None)
    assert resolved is not None
    assert MIN_INSTANT <= resolved.start <= MAX_INSTANT


@pytest.mark.parametrize(("bounds", "expected"), [("[]", False), ("[)", True), ("(]", True), ("()", True)])
def test_an_interval_of_one_instant_is_empty_unless_both_bounds_are_inclusive(bounds: str, expected: bool) -> None:
    resolved = parse_interval(10, 10, bounds).resolve(now=0, newest=None, oldest=None)
    assert resolved is not None
    assert resolved.is_empty is expected


def test_time_is_continuous_between_the_written_bounds() -> None:
    assert not ResolvedInterval(10, 11, True, True).is_empty


@pytest.mark.parametrize("wrong", ["", "[[", "]["])
def test_bounds_are_written_as_brackets(wrong: str) -> None:
    with pytest.raises(InvalidArgument, match="bounds"):
        parse_interval(0, 1, wrong)


def test_a_match_has_one_of_three_names() -> None:
    with pytest.raises(InvalidArgument, match='"span", "whole", "start"'):
        parse_match("part")


def test_times_are_shown_as_dates() -> None:
    assert format_instant(1_700_000_000_000_000_001) == "2023-11-14T22:13:20.000000001Z"
    assert format_duration(1_500_000_000) == "1.5 s"
    assert format_duration(-30_000_000) == "-30 ms"
    assert format_duration(0) == "0 s"
    assert format_duration(3_600_000_000_000 - 20_000_000) == "1 h"
    assert format_duration(3_600_000_000_000 - 40_000_000) == "59.999 m"
    assert [format_duration(one) for one in (999, 1_000, 999_999, 59_999_600_000)] == [
        "999 ns",
        "1 us",
        "999.999 us",
        "1 m",
    ]
    assert "ns" in format_instant(MAX_INSTANT * 1000)


@pytest.mark.parametrize("value", ["1000000000d", "-1000000000d", "106752d", timedelta(days=106752)])
def test_a_duration_out_of_range_is_refused_and_not_truncated(value: str | timedelta) -> None:
    with pytest.raises(InvalidArgument, match=r"max_age is .*; a duration is less than 292 years"):
        parse_duration(value, "max_age")
    with pytest.raises(InvalidArgument, match="less than 292 years"):
        NOW - value


def test_an_instant_out_of_range_is_refused_and_the_error_names_it() -> None:
    with pytest.raises(InvalidArgument, match=r"time is .*, which does not fit into 64 bits of nanoseconds"):
        parse_instant(datetime(9999, 1, 1, tzinfo=UTC), "time")
