"""The observers of a change. The host wakes or ends a few of them at a time, however many there are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Generic, Protocol, TypeVar

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.core.channel import Pieces, batched, run_to_end

OBSERVERS_PER_PIECE = 16
"""The most observers that one piece of work wakes or ends. Each may send a message in the event loop's next turn."""

Thing = TypeVar("Thing")


class ChannelObserver(Protocol):
    """A stream, a group or a set of blocked gets that a channel or group wakes after its changes."""

    def wake(self) -> None:
        """Note that the channel or group has changed."""

    def end(self, error: StampedeError) -> None:
        """Note that the host does not serve the channel or group any more. `error`: the reason."""


class ChangeObserver:
    """The base class of the observers of an `Observers`, which wakes each of them once.

    It wakes the observer again, at a later change, only after the observer has called `listen`.
    """

    def __init__(self) -> None:
        self._woken_by: list[Observers] = []

    @property
    def may_move(self) -> bool:
        """Whether this is a reader of a channel that may continue at a copy of the channel at this moment."""
        return False

    def note_woken(self, source: Observers) -> None:
        """Note that `source` wakes this observer now, and not again before `listen`."""
        self._woken_by.append(source)

    def listen(self) -> None:
        """Have the next change wake this observer. Call this before each look at the things that may have changed."""
        while self._woken_by:
            self._woken_by.pop().listen(self)

    def wake(self) -> None:
        """See `ChannelObserver`."""
        raise NotImplementedError

    def end(self, error: StampedeError) -> None:
        """See `ChannelObserver`."""
        raise NotImplementedError


class Backlog(Generic[Thing]):
    """A list of things to look at, in pieces. The first piece runs in `add`, unless earlier things still wait.

    A thing that waits keeps its place if it is added again, and is looked at only once. `look` may add and drop things.
    `begin` does long work for which no caller waits (`PieceScheduler.begin`).
    """

    def __init__(
        self, look: Callable[[Thing], None], begin: Callable[[Pieces[None]], None], per_piece: int = OBSERVERS_PER_PIECE
    ) -> None:
        self._look = look
        self._begin = begin
        self._per_piece = per_piece
        self._waiting: dict[Thing, None] = {}
        self._working = False

    def add(self, things: Iterable[Thing]) -> None:
        """Look at all these things, after the things that already wait."""
        self._waiting.update(dict.fromkeys(things))
        if self._waiting and not self._working:
            self._working = True
            self._begin(self._pieces())

    def drop(self, thing: Thing) -> None:
        """Take a thing off the list. Idempotent."""
        self._waiting.pop(thing, None)

    def _pieces(self) -> Pieces[None]:
        try:
            while self._look_at_some():
                yield
        finally:
            self._working = False

    def _look_at_some(self) -> bool:
        """Look at the next few things. Returns True if others are left."""
        for thing in [*islice(self._waiting, self._per_piece)]:
            if thing in self._waiting:  # the look at another thing may have dropped it
                del self._waiting[thing]
                self._look(thing)
        return bool(self._waiting)


class Observers:
    """The observers of one channel or group.

    A change wakes the observers that listen, and only these. An observer that has been woken listens again when it next
    looks at the channel. So the host wakes a busy observer once for each of its looks, not once for each change.
    """

    __slots__ = ("_begin", "_listening", "_observers", "_to_wake")

    def __init__(self, begin: Callable[[Pieces[None]], None] = run_to_end) -> None:
        """`begin`: see `Backlog`."""
        self._begin = begin
        self._observers: dict[ChangeObserver, None] = {}
        self._listening: dict[ChangeObserver, None] = {}
        self._to_wake: Backlog[ChangeObserver] | None = None  # made at the first wake, because most channels need none

    def __len__(self) -> int:
        return len(self._observers)

    def __iter__(self) -> Iterator[ChangeObserver]:
        """The present observers. They may leave during the iteration."""
        return iter([*self._observers])

    def add(self, observer: ChangeObserver) -> None:
        """Add `observer`. The next change wakes it. Idempotent."""
        self._observers[observer] = self._listening[observer] = None

    def listen(self, observer: ChangeObserver) -> None:
        """Have the next change wake `observer`, unless it was discarded."""
        if observer in self._observers:
            self._listening[observer] = None

    def discard(self, observer: ChangeObserver) -> None:
        """Remove `observer`. No change wakes it any more. Idempotent."""
        self._observers.pop(observer, None)
        self._listening.pop(observer, None)
        if self._to_wake is not None:
            self._to_wake.drop(observer)

    def wake(self) -> None:
        """Wake the listening observers, in pieces.

        The first piece runs in this call, unless the pieces of an earlier wake are still under way.
        """
        if not self._listening:
            return
        if self._to_wake is None:
            self._to_wake = Backlog(self._wake, self._begin)
        listening, self._listening = self._listening, {}
        self._to_wake.add(listening)

    def _wake(self, observer: ChangeObserver) -> None:
        observer.note_woken(self)
        observer.wake()

    def ending(self, error: StampedeError) -> Pieces[None]:
        """Call `end` of the present observers with `error`, in pieces."""
        return self._ending([*self._observers], error)

    def _ending(self, observers: Sequence[ChangeObserver], error: StampedeError) -> Pieces[None]:
        for at, part in enumerate(batched(observers, OBSERVERS_PER_PIECE)):
            if at:
                yield
            for observer in part:
                if observer in self._observers:  # it may have left meanwhile
                    observer.end(error)
