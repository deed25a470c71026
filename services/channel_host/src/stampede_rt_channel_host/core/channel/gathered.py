"""The slices of a large answer, in parts. One step frees one part, never all of them. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import overload

from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import Slice


class Gathered(Sequence[Slice]):
    """Slices in order. Each part holds the slices that one piece of work found."""

    __slots__ = ("_parts",)

    def __init__(self, parts: deque[list[Slice]]) -> None:
        """`parts` are not empty. The new object owns them from now on."""
        self._parts = parts

    def __len__(self) -> int:
        return sum(map(len, self._parts))

    def __bool__(self) -> bool:
        return bool(self._parts)

    def __iter__(self) -> Iterator[Slice]:
        return chain.from_iterable(self._parts)

    @overload
    def __getitem__(self, at: int) -> Slice: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Slice]: ...
    def __getitem__(self, at: int | slice) -> Slice | Sequence[Slice]:
        """The slice or slices at `at`. Walks all slices, except for -1."""
        return self._parts[-1][-1] if at == -1 else [*self][at]

    def drained(self) -> Iterator[Slice]:
        """Each slice in turn. Frees a part once its last slice was given."""
        while self._parts:
            yield from self._parts[0]
            self._parts.popleft()

    def emptying(self) -> Pieces[None]:
        """Free the remaining slices, in pieces."""
        while self._parts:
            self._parts.popleft()
            yield


def drained(slices: Sequence[Slice]) -> Iterator[Slice]:
    """The slices of an answer, one by one. Empties the answer on the way if it is a `Gathered`."""
    return slices.drained() if isinstance(slices, Gathered) else iter(slices)


def emptying(slices: Sequence[Slice]) -> Pieces[None]:
    """Free the slices of an answer that no caller gets, in pieces. Does nothing unless they are `Gathered`."""
    if isinstance(slices, Gathered):
        yield from slices.emptying()
