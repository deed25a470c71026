"""A map whose tables stay small."""

from __future__ import annotations

import pytest

from stampede_rt_channel_host.core.queue.chunked_map import ChunkedMap


def test_a_map_of_very_many_entries_has_no_large_table() -> None:
    numbers = ChunkedMap[str]()
    for number in range(5000, 15_000):
        numbers[number] = str(number)
    assert len(numbers) == 10_000
    assert max(len(table) for table in numbers._chunks.values()) <= 1024
    for number in range(5000, 15_000):
        del numbers[number]
    assert not numbers
    assert not numbers._chunks


def test_entries_are_found_and_given_in_the_order_of_numbers() -> None:
    numbers = ChunkedMap[str]()
    for number in (9000, 3, 2000, 4):
        numbers[number] = str(number)
    numbers[4] = "four"
    assert [*numbers.values()] == ["3", "four", "2000", "9000"]
    assert [*numbers.values(4)] == ["four", "2000", "9000"]
    assert [*numbers.values(2001)] == ["9000"]
    assert (numbers[4], numbers.get(5), numbers.get(10**6)) == ("four", None, None)
    with pytest.raises(KeyError):
        numbers[5]
