"""The supernodes that a front-end knows, and the supernodes that it names to callers."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_frontend.ranking import Supernode
from stampede_rt_frontend.roster import SUPERNODES_MAX, MemberList, ProbeAnswer, SupernodeRoster


def answer(
    name: str, *, ready: bool = True, trip: int | None = 10, cluster: str = "c1", former: tuple[str, ...] = ()
) -> ProbeAnswer:
    return ProbeAnswer(
        supernode_id=name, cluster_id=cluster, ready=ready, round_trip_nanos=trip, former_cluster_ids=former
    )


def members(*names: str, term: int = 1, index: int = 1, leader: str = "", zone: str = "") -> MemberList:
    listed = [Supernode(supernode_id=one, target=f"{one}:1", is_leader=one == leader, zone=zone) for one in names]
    return MemberList(term=term, applied_index=index, members=tuple(listed))


def known(roster: SupernodeRoster) -> dict[str, Supernode]:
    return {one.supernode_id: one for one in roster.supernodes()}


def test_at_first_a_front_end_probes_the_seeds_and_lists_no_supernode() -> None:
    roster = SupernodeRoster(("s1:1", "s2:1"))
    assert roster.targets() == ("s1:1", "s2:1")
    assert roster.supernodes() == []
    assert not roster.any_answered()


@pytest.mark.parametrize("count", [0, SUPERNODES_MAX + 1])
def test_the_number_of_seeds_has_bounds(count: int) -> None:
    with pytest.raises(ValueError, match="--supernodes"):
        SupernodeRoster(tuple(f"s{number}:1" for number in range(count)))


def test_callers_get_a_seed_that_answers_with_its_round_trip() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("s1:1", answer("s1", trip=800))
    roster.note_answer("s1:1", answer("s1", trip=1600))
    assert known(roster)["s1"].round_trip_nanos == 900
    assert roster.cluster_id == "c1"


def test_a_seed_that_is_no_longer_a_member_is_listed_to_no_caller_but_still_probed() -> None:
    roster = SupernodeRoster(("s1:1", "s2:1"))
    roster.note_answer("s1:1", answer("s1"))
    roster.note_answer("s2:1", answer("s2"))
    roster.update_members(members("s1", "s2"))
    roster.note_failure("s1:1", "gone")
    roster.update_members(members("s2", "s3", index=2))
    assert sorted(known(roster)) == ["s2", "s3"]
    assert "s1:1" in roster.targets()


def test_an_answer_without_a_measurement_keeps_the_old_one() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("s1:1", answer("s1", trip=800))
    roster.note_answer("s1:1", answer("s1", trip=None))
    assert known(roster)["s1"].round_trip_nanos == 800


def test_a_supernode_without_a_leader_answers_but_is_not_healthy() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("s1:1", answer("s1", ready=False, cluster=""))
    assert roster.any_answered()
    assert not roster.any_healthy()
    assert not known(roster)["s1"].healthy


def test_members_are_learned_from_the_directory_and_probed_from_then_on() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("s1:1", answer("s1"))
    roster.update_members(members("s1", "s2", leader="s2", zone="z"))
    assert roster.targets() == ("s1:1", "s2:1")
    assert known(roster)["s2"].is_leader
    assert known(roster)["s2"].zone == "z"
    assert not known(roster)["s2"].healthy
    assert known(roster)["s1"].healthy


def test_each_supernode_tells_its_own_zone_also_in_an_older_list() -> None:
    roster = SupernodeRoster(("s1:1",))
    members_by_s1 = (Supernode(supernode_id="s1", target="s1:1", zone="a"), Supernode(supernode_id="s2", target="s2:1"))
    members_by_s2 = (Supernode(supernode_id="s1", target="s1:1"), Supernode(supernode_id="s2", target="s2:1", zone="b"))
    roster.update_members(MemberList(term=1, applied_index=8, members=members_by_s1))
    roster.update_members(MemberList(term=1, applied_index=7, members=members_by_s2))
    roster.update_members(MemberList(term=1, applied_index=9, members=members_by_s1))
    assert {name: node.zone for name, node in known(roster).items()} == {"s1": "a", "s2": "b"}


def test_a_member_that_left_is_forgotten_but_a_seed_is_still_probed() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.update_members(members("s1", "s2", index=1))
    roster.update_members(members("s3", index=2))
    assert roster.targets() == ("s1:1", "s3:1")


def test_an_older_member_list_is_ignored() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.update_members(members("s1", "s2", term=2, index=9))
    roster.update_members(members("s1", "s9", term=1, index=99))
    roster.update_members(members("s1", "s9", term=2, index=8))
    assert roster.targets() == ("s1:1", "s2:1")


def test_an_empty_member_list_is_ignored() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.update_members(members("s1", "s2"))
    roster.update_members(members(index=5))
    assert roster.targets() == ("s1:1", "s2:1")


def test_a_member_list_has_a_bound_and_the_seeds_stay_within_it() -> None:
    roster = SupernodeRoster(("seed:1",))
    roster.update_members(members(*(f"s{number}" for number in range(2 * SUPERNODES_MAX))))
    assert len(roster.targets()) == SUPERNODES_MAX
    assert roster.targets()[0] == "seed:1"


def test_a_failure_is_remembered_until_the_next_answer() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("s1:1", answer("s1"))
    roster.note_failure("s1:1", "refused")
    assert roster.failures() == ["s1:1: refused"]
    assert not known(roster)["s1"].healthy
    roster.note_answer("s1:1", answer("s1"))
    assert roster.failures() == []
    assert known(roster)["s1"].healthy


def test_a_probe_of_a_removed_member_changes_nothing() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("gone:1", answer("gone"))
    roster.note_failure("gone:1", "refused")
    assert roster.targets() == ("s1:1",)
    assert roster.failures() == []


def test_a_supernode_with_two_addresses_is_listed_once_with_the_listed_address() -> None:
    roster = SupernodeRoster(("alias:1",))
    roster.note_answer("alias:1", answer("s1"))
    roster.update_members(members("s1"))
    roster.note_answer("s1:1", answer("s1"))
    assert [one.target for one in roster.supernodes()] == ["s1:1"]


def test_an_address_that_answers_comes_before_a_listed_one_that_does_not() -> None:
    roster = SupernodeRoster(("alias:1",))
    roster.note_answer("alias:1", answer("s1"))
    roster.update_members(members("s1"))
    roster.note_failure("s1:1", "not reachable from here")
    assert [one.target for one in roster.supernodes()] == ["alias:1"]


def test_a_supernode_of_another_cluster_is_left_out_while_ours_is_healthy() -> None:
    roster = SupernodeRoster(("s1:1", "x1:1"))
    assert roster.note_answer("s1:1", answer("s1"))
    assert not roster.note_answer("x1:1", answer("x1", cluster="c2"))
    assert list(known(roster)) == ["s1"]
    [failure] = roster.failures()
    assert failure.startswith("x1:1: belongs to another cluster, c2, and this front-end serves c1;")


def test_supernodes_of_another_cluster_are_left_out_even_if_no_supernode_of_the_own_cluster_answers() -> None:
    roster = SupernodeRoster(("s1:1", "s2:1"))
    roster.note_answer("s1:1", answer("s1"))
    for target in roster.targets():
        roster.note_failure(target, "no answer in time")
    assert not roster.note_answer("s2:1", answer("r", cluster="c2"))
    assert roster.cluster_id == "c1"
    assert roster.supernodes() == [one for one in roster.supernodes() if not one.healthy]


def test_a_successor_cluster_is_accepted_when_the_own_cluster_is_gone() -> None:
    roster = SupernodeRoster(("s1:1", "s2:1"))
    roster.note_answer("s1:1", answer("s1"))
    assert not roster.note_answer("s2:1", answer("r", cluster="c2", former=("c1",)))
    roster.note_failure("s1:1", "refused")
    assert roster.note_answer("s2:1", answer("r", cluster="c2", former=("c1",)))
    assert roster.cluster_id == "c2"


def test_a_front_end_takes_up_a_cluster_founded_anew_at_the_addresses_of_a_cluster_in_memory() -> None:
    roster = SupernodeRoster(("s1:1",))
    roster.note_answer("s1:1", answer("s1", cluster="memory-1"))
    roster.update_members(members("s1", "s2", term=7, index=70))
    roster.note_failure("s1:1", "refused")
    assert not roster.note_answer("s1:1", answer("n1", cluster="c2")), "a restored copy: the other members may live"
    assert roster.note_answer("s1:1", answer("n1", cluster="memory-2"))
    roster.update_members(members("n1", term=1, index=1))
    assert roster.cluster_id == "memory-2"
    assert list(known(roster)) == ["n1"]


EVENTS = st.one_of(
    st.builds(
        lambda target, name, ready, cluster: ("note_answer", target, answer(name, ready=ready, cluster=cluster)),
        st.sampled_from(["s1:1", "s2:1", "s3:1"]),
        st.sampled_from(["s1", "s2"]),
        st.booleans(),
        st.sampled_from(["", "c1", "c2"]),
    ),
    st.builds(lambda target: ("note_failure", target, "refused"), st.sampled_from(["s1:1", "s2:1", "s3:1"])),
    st.builds(
        lambda names, term: ("update_members", members(*names, term=term)),
        st.sets(st.sampled_from(["s1", "s2", "s3", "s4"])),
        st.integers(0, 3),
    ),
)


@given(st.lists(EVENTS, max_size=30))
def test_seeds_stay_probed_ids_are_listed_once_and_health_follows_the_last_probe_after_any_events(
    events: list[tuple[Any, ...]],
) -> None:
    roster = SupernodeRoster(("s1:1", "s9:1"))
    last_probe: dict[str, bool] = {}
    for kind, *arguments in events:
        accepted = getattr(roster, kind)(*arguments)
        if kind != "update_members":
            target, what = arguments
            last_probe[target] = kind == "note_answer" and accepted and what.ready
        last_probe = {target: last_probe.get(target, False) for target in roster.targets()}
        assert {"s1:1", "s9:1"} <= set(roster.targets())
        ids = [one.supernode_id for one in roster.supernodes()]
        assert len(ids) == len(set(ids))
        assert "" not in ids
        assert roster.any_healthy() == any(last_probe.values())
        assert all(one.healthy == last_probe[one.target] for one in roster.supernodes())
