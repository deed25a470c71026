"""A read that finds its only item directly gives the same answer as a scan of the index."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies

from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, Match
from stampede_rt_channel_host.core.channel import ChannelCore, ReadAnswer, selection
from tests.support.channel_host.channel_cores import a_channel, get, put

runs = strategies.lists(strategies.lists(strategies.integers(0, 30), min_size=1, max_size=4), max_size=12)
durations = strategies.sampled_from((None, 0, 1, 5, -1))
policies = strategies.sampled_from(({}, {"max_items": 5}, {"max_age_nanos": 12}, {"overlap_nanos": 4}))


def filled(puts: list[list[int]], duration: int | None, policy: dict[str, int]) -> ChannelCore:
    channel = a_channel(**policy)
    for times in puts:
        put(channel, *times, now=15, durations=None if duration is None else [duration] * len(times))
    return channel


def facts(answer: ReadAnswer | None) -> tuple[object, ...] | None:
    return None if answer is None else ([*answer.slices], *answer[1:])


@given(runs, durations, policies, strategies.integers(-2, 34), strategies.integers(10, 40))
def test_the_item_at_an_instant_is_the_one_that_a_scan_finds(
    puts: list[list[int]], duration: int | None, policy: dict[str, int], time: int, now: int
) -> None:
    channel = filled(puts, duration, policy)
    found, short = facts(get(channel, time, time, now=now)), facts(channel.at(time, now))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "_single", lambda *arguments: None)
        scanned = facts(get(channel, time, time, now=now))
    assert found == scanned
    assert short in (None, scanned)


@given(runs, durations, policies, strategies.integers(0, 34), strategies.integers(10, 40))
def test_the_last_item_of_an_interval_is_the_one_that_a_scan_finds(
    puts: list[list[int]], duration: int | None, policy: dict[str, int], bound: int, now: int
) -> None:
    channel = filled(puts, duration, policy)

    def last() -> list[tuple[object, ...] | None]:
        ends = ((MIN_INSTANT, MAX_INSTANT), (bound, MAX_INSTANT), (MIN_INSTANT, bound), (bound, bound + 5))
        return [
            facts(get(channel, *one, bounds, now=now, match=Match.START, limit=1, newest_first=True))
            for one in ends
            for bounds in ("[]", "[)", "(]", "()")
        ]

    found = last()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "_single", lambda *arguments: None)
        assert found == last()


def test_an_item_in_the_middle_of_a_long_run_is_found_without_a_scan() -> None:
    channel = a_channel()
    put(channel, *range(0, 1000, 10))
    found = channel.at(505, 10**6)
    assert found is not None
    [part] = found.slices
    assert (part.first_time, part.items, found.next_time) == (500, 1, 510)


def test_the_last_item_before_an_instant_is_found_without_a_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    channel = a_channel()
    put(channel, *range(0, 1000, 10))
    monkeypatch.setattr(selection, "_key_ranges", None)
    found = get(channel, end=500, bounds="[)", match=Match.START, limit=1, newest_first=True)
    [part] = found.slices
    assert (part.first_time, part.items, found.next_time, found.more) == (490, 1, 500, True)


def test_two_items_of_one_time_need_a_scan() -> None:
    channel = a_channel()
    put(channel, 10, 20, 20, 30)
    assert channel.at(25, 10**6) is None
    assert channel.at(15, 10**6) is not None
