"""Who consumes and takes under which number."""

from __future__ import annotations

import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt_channel_host.channels import id_owners as module
from stampede_rt_channel_host.channels.id_owners import OWNED_IDS_OF_ONE_MAX, IdOwners, own_name

QUEUE, OTHER = b"q" * 16, b"o" * 16


@pytest.fixture
def caller(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The name of the caller; empty: one whom rules do not judge."""
    names = ["alice"]
    monkeypatch.setattr(module, "owner_name", lambda: names[-1])
    return names


def test_a_number_belongs_to_the_caller_that_used_it_first(caller: list[str]) -> None:
    owners = IdOwners()
    owners.check(QUEUE, 7, "taker")
    owners.check(QUEUE, 7, "taker")
    caller.append("thief")
    owners.check(OTHER, 7, "taker")
    with pytest.raises(PermissionDenied, match="taker 0x7 belongs to alice, and thief may not act for it"):
        owners.check(QUEUE, 7, "taker")
    caller.append("")
    owners.check(QUEUE, 7, "taker")


def test_what_members_use_is_nobody_elses(caller: list[str]) -> None:
    owners = IdOwners()
    caller.append("")
    owners.check(QUEUE, 7, "consumer")
    caller.append("thief")
    with pytest.raises(PermissionDenied, match="belongs to a member or an operator"):
        owners.check(QUEUE, 7, "consumer")


def test_a_caller_of_many_numbers_makes_its_own_be_forgotten_and_no_others(caller: list[str]) -> None:
    owners = IdOwners()
    owners.check(QUEUE, 7, "taker")
    caller.append("thief")
    for number in range(1000, 1000 + 3 * OWNED_IDS_OF_ONE_MAX):
        owners.check(QUEUE, number, "taker")
    assert len(owners) == OWNED_IDS_OF_ONE_MAX + 1
    with pytest.raises(PermissionDenied):
        owners.check(QUEUE, 7, "taker")


def test_all_numbers_together_have_a_bound(caller: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "OWNED_IDS_MAX", 100)
    owners = IdOwners()
    for number in range(300):
        caller.append(f"caller-{number}")
        owners.check(QUEUE, number, "taker")
    assert len(owners) == len(owners._of_owner) == 100


def test_callers_with_a_shared_name_have_no_share(caller: list[str]) -> None:
    names = {}
    for name in ("alice", "@clients", ""):
        caller.append(name)
        names[name] = own_name()
    assert names == {"alice": "alice", "@clients": "", "": ""}
