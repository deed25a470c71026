"""Long work in pieces of about a millisecond each. Others run between two pieces (decision 0061). Pure."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

STEPS_PER_PIECE = 256
"""The slices, or the amount of work equal to them, that make one piece."""

ITEMS_PER_STEP = 8
"""This many items count as one step where work looks at single items."""

Result = TypeVar("Result")
Thing = TypeVar("Thing")
Pieces = Generator[None, None, Result]
"""Work that stops after each piece and continues when the caller asks for the next piece. The last piece returns the
result.

Unless the work says otherwise, the result is as of the moment at which the first piece began. If the work is dropped
before its end, close it, or use `abandoning` if it may have collected many things.
"""


class Abandoned(Exception):
    """Raised inside work that its caller drops.

    The work frees what it has collected, in pieces, and raises the error again.
    """


def abandoning(pieces: Pieces[Any]) -> Pieces[None]:
    """Drop the work, and free what it has collected, in pieces."""
    try:
        pieces.throw(Abandoned())
        while True:  # ends when the work has freed everything
            yield
            next(pieces)
    except (StopIteration, Abandoned):
        return
    finally:
        pieces.close()


def batched(things: Sequence[Thing], size: int) -> Iterator[Sequence[Thing]]:
    """The things in parts of `size`. The last part may be smaller."""
    return (things[at : at + size] for at in range(0, len(things), size))


def batched_keys(keys: Any, size: int) -> Iterator[list[Any]]:
    """The keys of a SortedList or SortedDict in parts of `size`, in order. No step copies all of them.

    Keys may come and go between two parts. Keys that come are included only if they belong behind the last part.
    """
    part = [*islice(keys, size)]
    while part:
        yield part
        part = [*islice(keys.irange(minimum=part[-1], inclusive=(False, True)), size)]


def run_to_end(pieces: Pieces[Result]) -> Result:
    """Perform all pieces, one after the other, and return the result."""
    while True:  # ends with the last piece
        try:
            next(pieces)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class Unfinished(Generic[Result]):
    """The rest of work that needs more than its first piece."""

    rest: Pieces[Result]


def first_of(pieces: Pieces[Result]) -> Result | Unfinished[Result]:
    """Perform the first piece. Returns the result if the work is done, as is usual, and an `Unfinished` otherwise."""
    try:
        next(pieces)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]
    return Unfinished(pieces)


def rest_of(pieces: Pieces[None]) -> list[Pieces[None]]:
    """Perform the first piece. Returns the rest of the work, in a list for `one_after_another`; empty: it is done."""
    found = first_of(pieces)
    return [found.rest] if isinstance(found, Unfinished) else []


def one_after_another(works: list[Pieces[None]]) -> Pieces[None]:
    """Perform begun work, the last one of the list first. Empties the list. The first piece does nothing."""
    while works:
        yield
        yield from works.pop()
