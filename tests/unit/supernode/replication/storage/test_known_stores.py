"""A member that has lost its disk is not taken for the member that it was before."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt_supernode.replication.storage.known_stores import FILE_NAME, KnownStores
from stampede_rt_supernode.replication.storage.store import StoreDamaged


def test_a_member_is_admitted_only_with_its_first_store_even_after_a_restart(tmp_path: Path) -> None:
    first = KnownStores.open(tmp_path, had_store=False)
    assert first.admits("b", "one")
    first.note("b", "one", "abc")
    first.note("b", "two", "abc")
    reopened = KnownStores.open(tmp_path, had_store=True)
    assert reopened.own == first.own
    assert (reopened.admits("b", "one"), reopened.admits("b", "two"), reopened.admits("c", "two")) == (
        True,
        False,
        True,
    )


def test_a_member_that_never_had_a_store_may_call_without_one_or_with_a_first_one(tmp_path: Path) -> None:
    stores = KnownStores.open(tmp_path, had_store=False)
    stores.note("b", "", "abc")
    assert (stores.admits("b", ""), stores.admits("b", "one")) == (True, True)


def test_a_member_that_had_a_store_is_refused_without_one(tmp_path: Path) -> None:
    stores = KnownStores.open(tmp_path, had_store=False)
    stores.note("c", "one", "abc")
    assert not stores.admits("c", "")


def test_a_store_keeps_the_refusals_of_other_members_over_a_restart(tmp_path: Path) -> None:
    KnownStores.open(tmp_path, had_store=False).note_own_refusal("it is an older copy")
    assert KnownStores.open(tmp_path, had_store=True).refused == "it is an older copy"


def test_a_new_store_has_a_new_id_even_if_the_note_of_the_old_id_exists(tmp_path: Path) -> None:
    former = KnownStores.open(tmp_path, had_store=False)
    former.note("b", "one", "abc")
    new = KnownStores.open(tmp_path, had_store=False)
    assert new.own != former.own
    assert new.admits("b", "two")


def test_a_member_without_a_disk_has_no_store_id_and_keeps_none_of_others() -> None:
    stores = KnownStores.open(None, had_store=False)
    stores.note("b", "one", "abc")
    assert (stores.own, stores.admits("b", "two")) == ("", True)


@pytest.mark.parametrize("position", range(0, 60, 7))
def test_a_flipped_bit_in_a_note_is_found(position: int, tmp_path: Path) -> None:
    KnownStores.open(tmp_path, had_store=False).note("b", "one", "abc")
    place = tmp_path / FILE_NAME
    content = bytearray(place.read_bytes())
    content[position] ^= 4
    place.write_bytes(content)
    with pytest.raises(StoreDamaged, match="under a new id"):
        KnownStores.open(tmp_path, had_store=True)


def test_invented_member_ids_displace_no_member_and_are_bounded(tmp_path: Path) -> None:
    stores = KnownStores.open(tmp_path, had_store=False)
    for name in "bc":
        stores.note(name, f"store of {name}", "abc")
    for number in range(300):
        stores.note(f"invented{number}", "any", "abc")
    reopened = KnownStores.open(tmp_path, had_store=True)
    assert [reopened.admits(name, "another") for name in "bc"] == [False, False]
    assert len((tmp_path / FILE_NAME).read_bytes()) < 2000
