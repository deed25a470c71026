"""The counts of open subscriptions."""

from __future__ import annotations

from contextlib import ExitStack

from stampede_rt_channel_host.channels.subscriptions.reader_drops import READERS_PER_PIECE, ReaderDrops, Readers
from stampede_rt_channel_host.core.channel import run_to_end


def slowest(readers: Readers, name: str, count: int = 9) -> list[ReaderDrops]:
    return run_to_end(readers.of_channel(name, count))


def test_a_channel_lists_at_most_the_wanted_number_of_its_readers_the_slowest_first() -> None:
    readers = Readers()
    with readers.reading("a") as quick, readers.reading("a") as slow, readers.reading("b"):
        slow.count(0, 5)
        quick.count(1, 0)
        assert slowest(readers, "a") == [slow, quick]
        assert slowest(readers, "a", 1) == [slow]
        assert (readers.dropped("a"), readers.dropped("b")) == (6, 0)
    assert slowest(readers, "a") == []


def test_a_channel_does_not_list_the_readers_of_a_group_with_the_same_name() -> None:
    readers = Readers()
    with readers.reading("a", of_group=True) as drops:
        drops.count(3, 0)
        assert slowest(readers, "a") == []
        assert readers.dropped("a") == 0


def test_a_channel_counts_drops_of_its_open_readers_and_the_sums_keep_the_drops_of_closed_readers() -> None:
    readers = Readers()
    with readers.reading("a") as first:
        with readers.reading("a") as second:
            first.count(1, 2)
            second.count(10, 0)
            second.count(20, 5)
            assert readers.dropped("a") == 28
        assert readers.dropped("a") == 3
        assert readers.sums() == (21, 7)
    assert readers.dropped("a") == 0
    assert readers.sums() == (21, 7)


def test_the_host_visits_the_readers_of_one_channel_in_pieces() -> None:
    readers = Readers()
    with ExitStack() as open_:
        for number in range(3 * READERS_PER_PIECE):
            open_.enter_context(readers.reading("a")).count(number, 0)
            open_.enter_context(readers.reading("b"))
        pieces = readers.of_channel("a", 2)
        assert sum(1 for _ in pieces) == 2
        assert [one.total for one in slowest(readers, "a", 2)] == [3 * READERS_PER_PIECE - 1, 3 * READERS_PER_PIECE - 2]
