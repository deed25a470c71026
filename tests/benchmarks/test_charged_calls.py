"""The benchmark of counted calls runs, and a call has few steps that count."""

from __future__ import annotations

import pytest

from tests.benchmarks.charged_calls import measure


@pytest.mark.parametrize(("method", "steps_max"), [("Put", 5.0), ("Get", 3.0)])
async def test_a_call_has_few_steps_that_count(method: str, steps_max: float) -> None:
    found = await measure(method, 50, 1)
    assert 1.0 < found.steps < steps_max
    assert len(found.counted_us) == len(found.uncounted_us) == 1
    assert method in found.text(method)
