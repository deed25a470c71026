"""A refusal by other members is final if the leader, or most of the others, confirm it."""

from __future__ import annotations

import pytest

from stampede_rt_supernode.replication.interface import TOO_OLD
from stampede_rt_supernode.replication.network.hello import (
    ANOTHER_STORE,
    NO_STORE,
    OLDER_STORE,
    OTHER_CLUSTER,
    REMOVED,
    UNKNOWN,
)
from stampede_rt_supernode.replication.network.refusals import RefusalGrounds, Refusals, grounds_of

COPY = f"PERMISSION_DENIED: 'a' {OLDER_STORE}: it held term 3 before"


@pytest.mark.parametrize(
    ("others", "refusing", "leader_id", "confirmed"),
    [
        ("bc", "b", None, False),
        ("bc", "b", "c", False),
        ("bc", "b", "b", True),
        ("bc", "bc", None, True),
        ("bcde", "bc", None, False),
        ("bcde", "bcd", None, True),
        ("b", "b", None, True),
        ("bc", "xyz", None, False),
        ("", "x", None, False),
    ],
)
def test_the_leader_or_most_of_the_others_confirm_a_refusal(
    others: str, refusing: str, leader_id: str | None, confirmed: bool
) -> None:
    refusals = Refusals()
    outcomes = [refusals.refused(name, COPY, others=others, leader_id=leader_id) for name in refusing]
    assert outcomes[-1] is confirmed
    assert (refusals.confirmed is RefusalGrounds.OLDER_STORE) is confirmed
    assert not any(outcomes[:-1])


def test_a_confirmed_refusal_names_the_members_that_refuse() -> None:
    refusals = Refusals()
    for name in "bc":
        refusals.refused(name, COPY, others="bc", leader_id=None)
    assert refusals.why == f"{COPY} (says b, c)"


def test_a_member_that_accepts_the_store_again_no_longer_refuses_it() -> None:
    refusals = Refusals()
    refusals.refused("b", COPY, others="bc", leader_id=None)
    assert refusals.accepted("b")
    assert not refusals.accepted("b")
    assert not refusals.refused("c", COPY, others="bc", leader_id=None)


def test_only_permanent_refusals_count() -> None:
    for words in (ANOTHER_STORE, NO_STORE, OLDER_STORE, REMOVED, TOO_OLD):
        assert grounds_of(f"'a' {words}; more") is not None
    for words in (UNKNOWN, OTHER_CLUSTER, "UNAVAILABLE: closing"):
        assert grounds_of(words) is None
