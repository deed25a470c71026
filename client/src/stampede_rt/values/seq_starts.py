"""The first seq of an owner that does not know the seqs of the former owners. Pure.

A lost owner may have given seqs to items that nobody else knows, and its host may bring them to the object store later.
So the next owner begins with the first seq of its epoch. This seq is above all seqs of the former owners. The first seq
of the next epoch is above all seqs of this owner.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

SEQS_PER_EPOCH = 2**44
"""As many items as an owner accepts in five years, if it accepts 100,000 a second."""
EPOCHS_MAX = 2**18  # seqs of later epochs would need more than 63 bits


def start_of(epoch: int) -> int:
    """Return the first seq of the owner of this epoch, if this owner does not know the seqs of the former owners."""
    return epoch * SEQS_PER_EPOCH + 1


def has_start(epoch: int) -> bool:
    """Whether the owner of this epoch may begin at `start_of`."""
    return epoch < EPOCHS_MAX


def is_start(seq: int) -> bool:
    """Whether an owner may have begun at this seq: it is the first seq of an epoch."""
    return seq > 1 and (seq - 1) % SEQS_PER_EPOCH == 0


def given_between(first: int, end: int) -> int:
    """Return how many items have the seqs from `first` up to `end`, exclusive, as far as the seqs alone show this.

    If an owner has begun at the start of its epoch, no host knows which of the seqs before this start belong to items.
    So this function counts only the seqs from the last such start on.
    """
    return max(0, end - begin_of(first, end))


def begin_of(first: int, end: int) -> int:
    """Return the first seq, from `first` on, that may be of the same owner as the last seq before `end`."""
    return max(first, (end - 1) // SEQS_PER_EPOCH * SEQS_PER_EPOCH + 1)


def given_over(first: int, end: int, ends: Iterable[int]) -> int:
    """Return the number of items as `given_between` does, but count also the seqs before the last start of an owner.

    `ends`: the seqs at which segments end, exclusive, in ascending order. The segments show that a former owner used
    the seqs up to such an end.
    """
    seqs = [first, *(one for one in ends if first < one < end), end]
    return sum(given_between(*one) for one in pairwise(seqs))
