"""Long work in pieces of about a millisecond each. Other work runs between two pieces (decision 0061). Pure."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

STEPS_PER_PIECE = 256
"""The slices, or the amount of work equal to them, that make one piece."""

ITEMS_PER_STEP = 8
"""If work looks at single items, this number of items counts as one step."""

Result = TypeVar("Result")
Thing = TypeVar("Thing")
Pieces = Generator[None, None, Result]
"""Work that stops after each piece and continues when the caller asks for the next piece. The last piece returns the
result.

Unless the docstring of the work says otherwise, the result is as of the moment at which the first piece began. A caller
that drops the work before its end closes it, or uses `abandoning` if the work may have collected many things.
"""


class WorkAbandoned(Exception):
    """`abandoning` raises this error inside the work.

    The work frees the things that it has collected, in pieces, and raises the error again.
    """


def abandoning(pieces: Pieces[Any]) -> Pieces[None]:
    """Drop the work. Frees the things that it has collected, in pieces."""
    try:
        pieces.throw(WorkAbandoned())
        while True:  # ends when the work has freed everything
            yield
            next(pieces)
    except (StopIteration, WorkAbandoned):
        return
    finally:
        pieces.close()


def batched(things: Sequence[Thing], size: int) -> Iterator[Sequence[Thing]]:
    """The things in parts of `size`. The last part may be smaller."""
    return (things[at : at + size] for at in range(0, len(things), size))


def batched_keys(keys: Any, size: int) -> Iterator[list[Any]]:
    """The keys of a SortedList or SortedDict in parts of `size`, in order. No step copies all keys.

    Keys may come and go between two parts. A new key is included only if it is greater than the keys of the last part.
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
class UnfinishedWork(Generic[Result]):
    """The rest of work that needs more than its first piece."""

    rest: Pieces[Result]


def first_of(pieces: Pieces[Result]) -> Result | UnfinishedWork[Result]:
    """Perform the first piece. Returns the result if the work is done, and otherwise an `UnfinishedWork`."""
    try:
        next(pieces)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]
    return UnfinishedWork(pieces)


def rest_of(pieces: Pieces[None]) -> list[Pieces[None]]:
    """Perform the first piece. Returns the rest of the work, in a list for `one_after_another`.

    The list is empty if the work is done.
    """
    found = first_of(pieces)
    return [found.rest] if isinstance(found, UnfinishedWork) else []


def one_after_another(tasks: list[Pieces[None]]) -> Pieces[None]:
    """Do the work of each entry of a list, the last one first, and empty the list. The first piece does nothing."""
    while tasks:
        yield
        yield from tasks.pop()
