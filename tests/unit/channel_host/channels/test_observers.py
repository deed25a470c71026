"""A change wakes a few observers in each turn of the event loop, however many there are. It leaves out none."""

from __future__ import annotations

import asyncio
import itertools

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_channel_host.channels.observers import OBSERVERS_PER_PIECE, ChangeObserver, Observers
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler

MANY = 4 * OBSERVERS_PER_PIECE


class Reader(ChangeObserver):
    """Looks at `state` when it is woken."""

    def __init__(self, book: Book, number: int) -> None:
        super().__init__()
        self._book = book
        self.number = number
        self.seen = 0
        self.error: StampedeError | None = None

    def wake(self) -> None:
        if not self._book.readers_are_busy:
            self.listen()
        self.seen = self._book.state
        self._book.woken.append(self.number)

    def end(self, error: StampedeError) -> None:
        self.error = error


class Book:
    """Many readers of one state."""

    def __init__(self, readers: int) -> None:
        self.state = 0
        self.readers_are_busy = False
        self.woken: list[int] = []
        self.observers = Observers(PieceScheduler().begin)
        self.readers = [Reader(self, number) for number in range(readers)]
        for reader in self.readers:
            self.observers.add(reader)

    def change(self) -> None:
        self.state += 1
        self.observers.wake()

    async def turns(self) -> list[int]:
        """The number of readers that wake after each turn of the event loop, until nothing more happens."""
        counts = [len(self.woken)]
        while len(counts) < 3 or counts[-1] != counts[-3]:
            await asyncio.sleep(0)
            counts.append(len(self.woken))
        return counts


async def test_a_few_observers_are_woken_before_the_call_returns() -> None:
    book = Book(OBSERVERS_PER_PIECE)
    book.change()
    assert book.woken == [*range(OBSERVERS_PER_PIECE)]


async def test_each_turn_wakes_a_few_of_many_observers_in_order() -> None:
    book = Book(MANY)
    book.change()
    counts = await book.turns()
    assert max(after - before for before, after in itertools.pairwise(counts)) == OBSERVERS_PER_PIECE
    assert book.woken == [*range(MANY)]


async def test_an_observer_that_was_woken_before_another_change_is_woken_again_after_the_others() -> None:
    book = Book(MANY)
    book.change()
    book.change()
    await book.turns()
    assert book.woken == [*range(MANY), *range(OBSERVERS_PER_PIECE)]
    assert {reader.seen for reader in book.readers} == {2}


async def test_endless_changes_still_wake_every_observer() -> None:
    book = Book(MANY)
    for _ in range(3 * MANY // OBSERVERS_PER_PIECE):
        book.change()
        await asyncio.sleep(0)
    assert {*book.woken} == {*range(MANY)}
    await book.turns()
    assert {reader.seen for reader in book.readers} == {book.state}


async def test_an_observer_that_has_not_looked_yet_is_not_woken_again() -> None:
    book = Book(MANY)
    book.readers_are_busy = True
    for _ in range(100):
        book.change()
        await book.turns()
    assert book.woken == [*range(MANY)]
    book.readers[3].listen()
    book.change()
    assert book.woken[MANY:] == [3]


async def test_an_observer_that_listens_before_it_looks_misses_no_change() -> None:
    book = Book(1)
    book.readers_are_busy = True
    book.change()
    book.change()  # while the reader is busy
    reader = book.readers[0]
    reader.listen()
    reader.seen = book.state
    book.change()
    assert (reader.seen, book.state) == (3, 3)


async def test_a_removed_observer_does_not_listen_again() -> None:
    book = Book(1)
    book.readers_are_busy = True
    book.change()
    book.observers.discard(book.readers[0])
    book.readers[0].listen()
    book.change()
    assert book.woken == [0]


async def test_a_removed_observer_is_neither_woken_nor_ended() -> None:
    book = Book(MANY)
    book.change()
    ending = book.observers.ending(Unavailable("gone"))
    book.observers.discard(book.readers[-1])
    late = Reader(book, MANY)
    book.observers.add(late)
    pieces = sum(1 for _ in ending)
    await book.turns()
    assert pieces == MANY // OBSERVERS_PER_PIECE - 1
    assert book.woken == [*range(MANY - 1)]
    assert [reader.error is None for reader in book.readers] == [False] * (MANY - 1) + [True]
    assert late.error is None, "this reader came after the end"
