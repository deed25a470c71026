"""The description of the machine of a measurement."""

from __future__ import annotations

import pytest

from stampede_rt_bench import machine
from stampede_rt_bench.machine import describe, steadiness


@pytest.mark.parametrize(
    ("loop_times", "expected"),
    [
        ([1.0] * 10, "0.0 % of bare loops over twice their median CPU time, the longest 1.0 x"),
        ([1.0] * 97 + [2.0, 5.0, 14.5], "2.0 % of bare loops over twice their median CPU time, the longest 14.5 x"),
    ],
)
def test_the_steadiness_says_how_many_loops_were_slow_and_how_slow(loop_times: list[float], expected: str) -> None:
    assert steadiness(loop_times) == expected


def test_a_description_has_the_steadiness_and_the_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(machine, "LOOPS_SECONDS", 0.01)
    described = describe(["pytest", "no-such-package"])
    assert "of bare loops" in described["steadiness"]
    assert (described["pytest"], described["no-such-package"]) == (pytest.__version__, "not installed")
