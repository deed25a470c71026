"""The seqs at which an owner begins that does not know the seqs of the former owners. Pure.

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
    """The seq at which the owner of this epoch begins if it does not know the seqs of the former owners."""
    return epoch * SEQS_PER_EPOCH + 1


def has_start(epoch: int) -> bool:
    """Whether the owner of this epoch may begin at `start_of`."""
    return epoch < EPOCHS_MAX


def given_between(first: int, end: int) -> int:
    """How many of the seqs from `first` up to `end`, exclusive, belong to items, as far as the seqs tell.

    If an owner has begun at the start of its epoch, no host knows how many of the seqs before have been used. So each
    count of items by their seqs counts only the seqs from that start on.
    """
    return max(0, end - begin_of(first, end))


def begin_of(first: int, end: int) -> int:
    """The first seq that the owner of the seq before `end` may have given, from `first` on."""
    return max(first, (end - 1) // SEQS_PER_EPOCH * SEQS_PER_EPOCH + 1)


def given_over(first: int, end: int, ends: Iterable[int]) -> int:
    """As `given_between`, if the seqs of some segments end at `ends`, in ascending order. So the seqs before the start
    of a later owner count as far as the segments tell.
    """
    seqs = [first, *(one for one in ends if first < one < end), end]
    return sum(given_between(*one) for one in pairwise(seqs))
