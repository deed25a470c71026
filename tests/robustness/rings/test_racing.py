"""A short race of readers and the writer of a ring. `make race-rings` runs it for minutes."""

from __future__ import annotations

import pytest

from stampede_rt.transports import futexes
from tests.robustness.rings.racing import race


@pytest.mark.skipif(not futexes.is_supported(), reason="shared memory needs Linux on x86-64")
def test_no_reader_returns_a_torn_recycled_or_reordered_item() -> None:
    counts = race(1.0)
    assert all(counts[way] for way in ("newest", "next", "interval")), counts
