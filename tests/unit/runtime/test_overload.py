"""The host counts each refusal, and logs some of them."""

from __future__ import annotations

from stampede_rt_runtime.overload import LOG_PERIOD_NANOS, OverloadCounter


def test_each_log_line_has_the_number_of_items_refused_since_the_last_line() -> None:
    overload = OverloadCounter()
    assert overload.ago_nanos(5) is None
    assert overload.note(3, 100) == 3
    assert [overload.note(1, 100 + step) for step in range(10)] == [None] * 10
    assert overload.note(2, 100 + LOG_PERIOD_NANOS) == 12
    assert (overload.refused, overload.ago_nanos(110 + LOG_PERIOD_NANOS)) == (15, 10)
