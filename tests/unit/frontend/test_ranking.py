"""The order in which a front-end lists supernodes for a caller."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_frontend.ranking import Supernode, rank, smooth


def node(name: str, *, healthy: bool = True, zone: str = "", trip: int | None = None) -> Supernode:
    return Supernode(
        supernode_id=name, target=f"{name}:1", zone=zone, has_answered=healthy, healthy=healthy, round_trip_nanos=trip
    )


def ids(nodes: list[Supernode], zone: str = "") -> list[str]:
    return [one.supernode_id for one in rank(nodes, zone)]


def test_a_healthy_supernode_comes_before_a_near_one() -> None:
    assert ids([node("near", healthy=False, trip=1), node("far", trip=1000)]) == ["far", "near"]


def test_a_supernode_of_the_callers_zone_comes_before_a_near_one() -> None:
    assert ids([node("near", zone="b", trip=1), node("same", zone="a", trip=1000)], "a") == ["same", "near"]


def test_health_comes_before_the_zone() -> None:
    assert ids([node("sick", healthy=False, zone="a"), node("well", zone="b")], "a") == ["well", "sick"]


def test_without_a_zone_of_the_caller_the_round_trip_decides() -> None:
    assert ids([node("far", zone="", trip=9), node("near", zone="b", trip=3)]) == ["near", "far"]


def test_a_round_trip_that_was_never_measured_is_the_longest() -> None:
    assert ids([node("unknown"), node("far", trip=10**12), node("zero", trip=0)]) == ["zero", "far", "unknown"]


def test_the_id_decides_between_equals() -> None:
    assert ids([node("c", trip=1), node("a", trip=1), node("b", trip=1)]) == ["a", "b", "c"]


NODES = st.builds(
    Supernode,
    supernode_id=st.sampled_from("abc"),
    target=st.text(max_size=3),
    zone=st.sampled_from(["", "x", "y"]),
    healthy=st.booleans(),
    round_trip_nanos=st.none() | st.integers(0, 5),
)


@given(st.lists(NODES, max_size=8), st.sampled_from(["", "x"]))
def test_ranking_keeps_all_supernodes_puts_healthy_ones_first_and_is_stable(nodes: list[Supernode], zone: str) -> None:
    ranked = rank(nodes, zone)
    assert sorted(map(repr, ranked)) == sorted(map(repr, nodes))
    health = [one.healthy for one in ranked]
    assert health == sorted(health, reverse=True)
    assert rank(ranked, zone) == ranked


def test_the_first_measurement_is_taken_as_it_is() -> None:
    assert smooth(None, 800) == 800


@given(st.integers(0, 10**12), st.integers(0, 10**12))
def test_a_smoothed_round_trip_lies_between_the_old_one_and_the_sample(old: int, sample: int) -> None:
    assert min(old, sample) <= smooth(old, sample) <= max(old, sample)


def test_one_outlier_counts_for_an_eighth_and_a_lasting_change_wins() -> None:
    assert smooth(800, 8800) == 1800
    trip = 800
    for _ in range(60):
        trip = smooth(trip, 8800)
    assert 8700 < trip <= 8800
