"""The rates of channels between two looks."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.cli.channel_rates import arranged, jitter_of, rates_of
from stampede_rt.values.statistics import ChannelStats, ConsumerStats

S = 10**9
STATS = ChannelStats(
    accepted=100, held=10, collected={}, rejected={"TOO_OLD": 1}, accepted_bytes=1000, held_bytes=100,
    delivered_bytes=500, newest=90 * S, oldest=80 * S, frontier=None, advance=None, subscriptions=2, waiting_gets=0,
    waiting_puts=0, incarnation=7, host_time=100 * S,
)  # fmt: skip


def test_a_rate_is_the_growth_by_the_hosts_time() -> None:
    later = replace(
        STATS, accepted=150, accepted_bytes=3000, delivered_bytes=600, rejected={"TOO_OLD": 5}, host_time=102 * S
    )
    (row,) = rates_of({"a": ("h1", STATS)}, {"a": ("h1", later)})
    assert (row.items, row.bytes_in, row.bytes_out, row.refused) == (25, 1000, 50, 2)
    assert (row.age_nanos, row.held, row.subscriptions, row.host) == (12 * S, 10, 2, "h1")


def test_drops_are_zero_after_a_slow_reader_has_left() -> None:
    slow, gone = replace(STATS, dropped=10, host_time=102 * S), replace(STATS, dropped=0, host_time=104 * S)
    assert rates_of({"a": ("h1", STATS)}, {"a": ("h1", slow)})[0].dropped == 5
    assert rates_of({"a": ("h1", slow)}, {"a": ("h1", gone)})[0].dropped == 0


def test_a_new_channel_and_one_with_a_new_incarnation_have_no_rates_yet() -> None:
    anew = replace(STATS, incarnation=8, accepted=5, newest=None)
    for before in ({}, {"a": ("h1", STATS)}):
        (row,) = rates_of(before, {"a": ("h2", anew)})
        assert (row.items, row.bytes_in, row.age_nanos) == (0, 0, None)


def test_rows_are_sorted_by_the_chosen_column_and_then_by_name() -> None:
    now = {name: ("h1", replace(STATS, held=held)) for name, held in (("b", 1), ("a", 1), ("cam", 9))}
    rows = rates_of(now, now)
    assert [row.channel for row in arranged(rows, "held")] == ["cam", "a", "b"]
    assert [row.channel for row in arranged(rows, "name")] == ["a", "b", "cam"]
    assert [row.channel for row in arranged(rows, "bytes", "a")] == ["a", "cam"]


def test_the_lag_is_the_lag_of_the_slowest_consumer() -> None:
    places = tuple(ConsumerStats(consumer_id=number, lease_nanos=1, waiting=number * 10) for number in range(3))
    (row,) = rates_of({}, {"a": ("h1", replace(STATS, consumers=places))})
    assert row.lag_items == 20


def test_jitter_is_the_spread_of_the_times_between_items_in_any_order() -> None:
    assert jitter_of([0, 100, 200, 300]) == 0
    assert jitter_of([300, 0, 200, 100, 420]) == round((3 * 25 + 15**2) ** 0.5 / 2)
    assert jitter_of([0, 100]) is None
