"""The slices of a large answer, in parts. The host frees part by part, so that no caller waits long. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from itertools import chain
from typing import overload

from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import Slice


class SlicesInParts(Sequence[Slice]):
    """Slices in order, kept in parts. Each part holds the slices that one piece of work found."""

    __slots__ = ("_parts",)

    def __init__(self, parts: deque[list[Slice]]) -> None:
        """Takes over `parts`, each of which has at least one slice."""
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
        """The slice or slices at `at`. Scans all slices, unless `at` is -1."""
        return self._parts[-1][-1] if at == -1 else [*self][at]

    def drained(self) -> Iterator[Slice]:
        """Each slice in turn. Frees a part when the caller asks for the slice after it."""
        while self._parts:
            yield from self._parts[0]
            self._parts.popleft()

    def emptying(self) -> Pieces[None]:
        """Free the remaining slices, in pieces."""
        while self._parts:
            self._parts.popleft()
            yield


def drained(slices: Sequence[Slice]) -> Iterator[Slice]:
    """The slices of an answer, one by one. If the answer is a `SlicesInParts`, the iteration empties it."""
    return slices.drained() if isinstance(slices, SlicesInParts) else iter(slices)


def emptying(slices: Sequence[Slice]) -> Pieces[None]:
    """Free, in pieces, slices that the host will not send. Does nothing unless `slices` is a `SlicesInParts`."""
    if isinstance(slices, SlicesInParts):
        yield from slices.emptying()
