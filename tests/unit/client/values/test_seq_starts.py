"""The first seq of an owner that does not know the seqs of the former owners."""

from __future__ import annotations

import pytest

from stampede_rt.values.seq_starts import EPOCHS_MAX, given_between, has_start, is_start, start_of


def test_the_starts_of_the_owners_rise_and_fit_into_63_bits() -> None:
    assert 1 < start_of(1) < start_of(2) < start_of(EPOCHS_MAX) < 2**63
    assert has_start(EPOCHS_MAX - 1)
    assert not has_start(EPOCHS_MAX)


@pytest.mark.parametrize(
    ("first", "end", "given"),
    [
        (5, 10, 5),
        (1, 1, 0),
        (5, start_of(2), 0),
        (5, start_of(2) + 3, 3),
        (start_of(1) + 5, start_of(3) + 1, 1),
        (start_of(2) + 5, start_of(2) + 9, 4),
    ],
)
def test_the_seqs_skipped_before_a_start_are_no_items(first: int, end: int, given: int) -> None:
    assert given_between(first, end) == given


def test_an_owner_may_begin_only_at_the_first_seq_of_an_epoch() -> None:
    assert [is_start(one) for one in (1, 2, start_of(1), start_of(1) + 1, start_of(9))] == [
        False,
        False,
        True,
        False,
        True,
    ]
