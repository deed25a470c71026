"""The limit of a rate, which allows bursts."""

from __future__ import annotations

import pytest

from stampede_rt_channel_host.core.token_bucket import TokenBucket


def test_a_burst_is_allowed_immediately_and_the_rest_at_the_rate() -> None:
    bucket = TokenBucket(rate=100, burst=50, now_s=0)
    assert bucket.spend(50, 0) == 0
    assert bucket.spend(10, 0) == pytest.approx(0.1)
    assert bucket.spend(10, 0) == pytest.approx(0.2)
    assert bucket.spend(10, 0.3) == 0


def test_after_a_long_pause_no_more_than_one_burst_is_allowed() -> None:
    bucket = TokenBucket(rate=100, burst=50, now_s=0)
    assert bucket.spend(50, 1000) == 0
    assert bucket.spend(50, 1000) == pytest.approx(0.5)
