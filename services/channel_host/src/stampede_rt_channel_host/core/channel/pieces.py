"""Long work in pieces of about a millisecond each, between which everybody else goes on (decision 0061). Pure."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

STEPS_PER_PIECE = 256
"""So many slices, or so much work as these take, is one piece."""

ITEMS_PER_STEP = 8
"""Where items are looked at one by one, so many count as one step."""

Result = TypeVar("Result")
Thing = TypeVar("Thing")
Pieces = Generator[None, None, Result]
"""Work that stops after each piece and goes on when it is asked for the next one; its result comes with the last one.

What it finds is as of the moment when it was begun. If it is not taken to its end, close it; or take `abandoning`, if
what it has found so far may be much.
"""


class Abandoned(Exception):
    """Raised in work whose result nobody wants: it lets go of what it has found, in pieces, and raises this on."""


def abandoning(pieces: Pieces[Any]) -> Pieces[None]:
    """Take the work no further: let go of what it has found, in pieces."""
    try:
        pieces.throw(Abandoned())
        while True:  # ends with what it has found
            yield
            next(pieces)
    except (StopIteration, Abandoned):
        return
    finally:
        pieces.close()


def batched(things: Sequence[Thing], size: int) -> Iterator[Sequence[Thing]]:
    """The things in parts of `size`; the last part may be smaller."""
    return (things[at : at + size] for at in range(0, len(things), size))


def run_to_end(pieces: Pieces[Result]) -> Result:
    """Do all pieces, one after the other, and give the result."""
    while True:  # ends with the pieces
        try:
            next(pieces)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class Unfinished(Generic[Result]):
    """The first piece was not all: what is left."""

    rest: Pieces[Result]


def first_of(pieces: Pieces[Result]) -> Result | Unfinished[Result]:
    """The result, if the first piece brings it, as nearly always."""
    try:
        next(pieces)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]
    return Unfinished(pieces)
