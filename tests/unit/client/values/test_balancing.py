"""Moves that even out the loads of hosts."""

from __future__ import annotations

import pytest

from stampede_rt.values.balancing import MOVES_MAX, PlannedMove, plan_moves


def load_after(busy: dict[str, int], planned: list[PlannedMove]) -> dict[str, int]:
    load = dict(busy)
    for one in planned:
        load[one.source] -= one.busy_permille
        load[one.host] += one.busy_permille
    return load


def test_the_busiest_host_gives_channels_to_the_least_busy_one() -> None:
    busy = {"h1": 800, "h2": 0}
    planned = plan_moves(busy, {"h1": {"a": 5, "b": 1, "c": 1, "d": 1}, "h2": {}}, [])
    assert {(one.source, one.host) for one in planned} == {("h1", "h2")}
    assert load_after(busy, planned) == {"h1": 300, "h2": 500}


def test_about_equally_busy_hosts_keep_their_channels() -> None:
    assert plan_moves({"h1": 340, "h2": 250}, {"h1": {"a": 1, "b": 1}, "h2": {}}, []) == []
    assert plan_moves({"h1": 900}, {"h1": {"a": 1, "b": 1}}, []) == []


def test_a_channel_that_is_the_whole_load_stays_because_another_host_would_be_as_busy() -> None:
    assert plan_moves({"h1": 900, "h2": 0}, {"h1": {"a": 1}, "h2": {}}, []) == []


def test_channels_of_one_group_move_together() -> None:
    rates = {"h1": {"left": 1.0, "right": 1.0, "x": 1.0, "y": 1.0}, "h2": {}}
    planned = plan_moves({"h1": 800, "h2": 0}, rates, [("left", "right", "elsewhere")])
    moved = {one.channel for one in planned}
    assert moved in ({"left", "right"}, {"x", "y"})


def test_a_plan_moves_each_channel_at_most_once_and_its_length_is_limited() -> None:
    rates = {"h1": {f"c{number}": 1.0 for number in range(5000)}, "h2": {}, "h3": {}}
    planned = plan_moves({"h1": 900_000, "h2": 0, "h3": 0}, rates, [])
    assert len(planned) == len({one.channel for one in planned}) == MOVES_MAX


@pytest.mark.parametrize("hosts", [2, 3, 5])
def test_a_plan_never_makes_the_busiest_host_busier(hosts: int) -> None:
    busy = {f"h{number}": 1000 // (number + 1) for number in range(hosts)}
    rates = {host: {f"{host}/{one}": one + 1.0 for one in range(7)} for host in busy}
    planned = plan_moves(busy, rates, [])
    assert planned
    assert max(load_after(busy, planned).values()) < max(busy.values())


def test_a_channel_that_cannot_move_stays_with_the_members_of_its_groups() -> None:
    busy = {"h1": 900, "h2": 0}
    rates = {"h1": {"recorded": 1.0, "with it": 1.0, "free": 1.0}, "h2": {}}
    planned = plan_moves(busy, rates, [["recorded", "with it"]], {"recorded"})
    assert [one.channel for one in planned] == ["free"]
