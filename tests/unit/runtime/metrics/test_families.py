"""Metrics as values."""

from __future__ import annotations

from stampede_rt_runtime.metrics.families import Durations, counter, histogram


def test_a_duration_counts_in_each_bucket_whose_bound_is_not_below_it() -> None:
    durations = Durations((0.1, 1.0))
    for seconds in (0.05, 0.1, 0.5, 7.0):
        durations.add(seconds)
    found = durations.family(histogram("a_seconds", "A."))
    assert list(found.buckets) == [("0.1", 2), ("1", 3), ("+Inf", 4)]
    assert found.sum_seconds == 7.65


def test_a_sample_has_a_value_for_each_label() -> None:
    metric = counter("a_total", "A.", "cause", "host")
    assert metric.of(3, "age", "h1").samples == [(("age", "h1"), 3)]
