"""The page that Prometheus reads."""

from __future__ import annotations

from stampede_rt_runtime.metrics.exposition import printed
from stampede_rt_runtime.metrics.families import Durations, counter, gauge, histogram


def test_a_counter_is_printed_with_its_help_and_its_labels() -> None:
    metric = counter("stampede_items_total", "Items.", "cause")
    assert printed(metric.of(3, "age")).decode().splitlines() == [
        "# HELP stampede_items_total Items.",
        "# TYPE stampede_items_total counter",
        'stampede_items_total{cause="age"} 3.0',
    ]


def test_a_histogram_is_printed_with_its_sum_and_count() -> None:
    durations = Durations((1.0,))
    durations.add(0.25)
    lines = printed(durations.family(histogram("stampede_seconds", "Seconds."))).decode().splitlines()
    assert lines[2:] == [
        'stampede_seconds_bucket{le="1"} 1.0',
        'stampede_seconds_bucket{le="+Inf"} 1.0',
        "stampede_seconds_count 1.0",
        "stampede_seconds_sum 0.25",
    ]


def test_control_characters_in_a_label_are_escaped_and_make_no_new_line() -> None:
    page = printed(gauge("stampede_a", "A.", "name").of(1, 'x"\n\x1b[31m\\')).decode()
    assert len(page.splitlines()) == 3
    assert "\x1b" not in page
