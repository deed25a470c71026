"""How large a ring in shared memory must be for the runs of its channel. Pure."""

from __future__ import annotations

DATA_BYTES_MIN, DATA_BYTES_MAX = 4 * 2**20, 64 * 2**20
RUNS_MIN = 40
"""A ring has room for this many of the longest runs, if DATA_BYTES_MAX allows it.

A producer may have 8 MiB under way. Runs of medium items have up to 224 KiB, so a reader that is one such burst behind
still finds its next items in the ring.
"""
_RUNS_OF_LARGEST_RING = 4  # a reader needs time to copy a run


def data_bytes_for(run_bytes: int) -> int:
    """The bytes of data of a ring for runs of up to this length. A multiple of DATA_BYTES_MIN, so that a ring seldom
    needs a larger successor when the items grow.
    """
    wanted = -(-RUNS_MIN * run_bytes // DATA_BYTES_MIN) * DATA_BYTES_MIN
    return min(max(wanted, DATA_BYTES_MIN), DATA_BYTES_MAX)


def longest_run(data_bytes: int) -> int:
    """The longest run that a ring with this much data takes. A longer one needs a larger ring, or none."""
    return data_bytes // (RUNS_MIN if data_bytes < DATA_BYTES_MAX else _RUNS_OF_LARGEST_RING)
