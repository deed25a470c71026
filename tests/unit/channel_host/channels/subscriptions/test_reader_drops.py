"""The counts of open subscriptions."""

from __future__ import annotations

from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers


def test_a_channel_has_its_own_readers_the_slowest_first_and_at_most_the_wanted_number() -> None:
    readers = Readers()
    with readers.reading("a") as quick, readers.reading("a") as slow, readers.reading("b"):
        slow.skipped, quick.collected = 5, 1
        assert list(readers.of_channel("a", 9)) == [slow, quick]
        assert list(readers.of_channel("a", 1)) == [slow]
        assert readers.dropped_by_channel() == {"a": 6}
    assert list(readers.of_channel("a", 9)) == []


def test_a_reader_of_a_group_is_none_of_a_channel_with_the_same_name() -> None:
    readers = Readers()
    with readers.reading("a", of_group=True) as drops:
        drops.collected = 3
        assert list(readers.of_channel("a", 9)) == []
        assert readers.dropped_by_channel() == {}
