"""The benchmark of wide groups runs through on a small scale; no time is judged here."""

from __future__ import annotations

from tests.benchmarks.wide_groups import measure


def test_two_hosts_feed_their_channels_and_report_them_to_each_other() -> None:
    alone, grouped = measure(2, seconds=0.3, warm_seconds=0.1)
    assert alone.messages_per_second == 0
    assert grouped.messages_per_second > 0
    assert grouped.items_per_second > 0
    assert grouped.cpu_us_per_item > 0
