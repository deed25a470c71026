"""Tests of the pieces of long work."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

from sortedcontainers import SortedDict, SortedList

from stampede_rt_channel_host.core.channel import Pieces, batched_keys, one_after_another, rest_of


class CountedKeys(SortedList):  # type: ignore[misc]
    """Counts the keys that its users read."""

    read = 0

    def _counted(self, keys: Iterator[Any]) -> Iterator[Any]:
        for key in keys:
            self.read += 1
            yield key

    def __iter__(self) -> Iterator[Any]:
        return self._counted(super().__iter__())

    def irange(self, *args: Any, **kwargs: Any) -> Iterator[Any]:
        return self._counted(super().irange(*args, **kwargs))


def test_the_keys_of_a_part_are_read_when_the_caller_takes_the_part() -> None:
    keys = CountedKeys(range(1000))
    parts = batched_keys(keys, 10)
    assert keys.read == 0
    assert [next(parts), next(parts)] == [[*range(10)], [*range(10, 20)]]
    assert keys.read == 20
    assert [*chain.from_iterable(parts)] == [*range(20, 1000)]


def test_keys_may_be_added_and_removed_between_two_parts() -> None:
    things = SortedDict(dict.fromkeys(range(0, 40, 2), "thing"))
    parts = batched_keys(things, 5)
    assert next(parts) == [0, 2, 4, 6, 8]
    for gone in (8, 12, 38):
        del things[gone]
    things[3] = things[11] = "new"
    assert [*chain.from_iterable(parts)] == [10, 11, *range(14, 38, 2)]


def test_several_pieces_of_work_continue_one_after_another_after_a_pause() -> None:
    done: list[str] = []

    def work(name: str, pieces: int) -> Pieces[None]:
        for piece in range(pieces):
            if piece:
                yield
            done.append(f"{name}{piece}")

    left = [*rest_of(work("a", 1)), *rest_of(work("b", 3)), *rest_of(work("c", 2))]
    assert done == ["a0", "b0", "c0"]
    rest = one_after_another(left)
    next(rest)
    assert done == ["a0", "b0", "c0"]
    assert len([*rest]) == 2
    assert done == ["a0", "b0", "c0", "c1", "b1", "b2"]
    assert left == []
