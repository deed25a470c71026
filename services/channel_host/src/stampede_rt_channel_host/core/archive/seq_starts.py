"""The seqs at which owners begin if they do not know the seqs of the former owners. Pure.

A host may take a channel over while the object store with its archive is away. Then it begins with the first seq of its
epoch. This seq is above all seqs of the former owners. The first seq of the next epoch is above all seqs of this owner.
"""

from __future__ import annotations

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
    """How many of the seqs from `first` up to `end`, exclusive, belong to items, as far as the archive can know.

    If an owner has begun at the start of its epoch, no host knows how many of the seqs before have been used.
    """
    start = (end - 1) // SEQS_PER_EPOCH * SEQS_PER_EPOCH + 1
    return max(0, end - max(first, start))
