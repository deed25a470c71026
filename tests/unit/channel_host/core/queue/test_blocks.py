"""A map whose tables stay small."""

from __future__ import annotations

import pytest

from stampede_rt_channel_host.core.queue.blocks import Blocks


def test_a_map_of_very_many_entries_has_no_large_table() -> None:
    blocks = Blocks[str]()
    for number in range(5000, 15_000):
        blocks[number] = str(number)
    assert len(blocks) == 10_000
    assert max(len(table) for table in blocks._blocks.values()) <= 1024
    for number in range(5000, 15_000):
        del blocks[number]
    assert not blocks
    assert not blocks._blocks


def test_entries_are_found_and_given_in_the_order_of_numbers() -> None:
    blocks = Blocks[str]()
    for number in (9000, 3, 2000, 4):
        blocks[number] = str(number)
    blocks[4] = "four"
    assert [*blocks.values()] == ["3", "four", "2000", "9000"]
    assert [*blocks.values(4)] == ["four", "2000", "9000"]
    assert [*blocks.values(2001)] == ["9000"]
    assert (blocks[4], blocks.get(5), blocks.get(10**6)) == ("four", None, None)
    with pytest.raises(KeyError):
        blocks[5]
