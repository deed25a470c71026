"""Guards an object store: while the store fails, one call at a time tries it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from threading import Lock

from stampede_rt_channel_host.archive.objects.segment_store import FoundObject, SegmentStore, StoreError

PAUSE_SECONDS = 1.0


class GuardedStore:
    """Passes calls on to a store. While the store fails, one call at a time tries it, and the others fail immediately.

    So a store that does not answer blocks one thread of the archive, and not all of them. A refused call is not a
    failure of the store: a store may refuse to delete objects, and still serve reads. Any thread may use this object.
    """

    def __init__(self, store: SegmentStore, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock`: in seconds."""
        self.url = store.url
        self.failure = ""
        """Why the last call failed; empty: it succeeded."""
        self._store, self._clock = store, clock
        self._lock = Lock()
        self._failed_at = 0.0
        self._is_unreachable = self._is_tried = False

    async def create(self, name: str, content: bytes | bytearray) -> bool:
        """See `SegmentStore`. Always tries the store: the caller makes pauses between its calls."""
        try:
            made = await self._store.create(name, content)
        except StoreError as error:
            self._note(str(error.strerror), is_away=not error.is_refusal)
            raise
        except asyncio.CancelledError:
            self._note(f"the object store {self.url} does not answer in time", is_away=True)
            raise
        self._note("")
        return made

    def read(self, name: str, offset: int, size: int) -> bytes:
        """See `SegmentStore`."""
        with self._trial():
            return self._store.read(name, offset, size)

    def find(self, prefix: str) -> Iterator[FoundObject]:
        """See `SegmentStore`."""
        with self._trial():
            yield from self._store.find(prefix)

    def delete(self, names: Sequence[str]) -> None:
        """See `SegmentStore`."""
        with self._trial():
            self._store.delete(names)

    @contextmanager
    def _trial(self) -> Iterator[None]:
        is_trial = self._enter()
        try:
            yield
        except StoreError as error:
            self._note(str(error.strerror), is_away=not error.is_refusal)
            raise
        except FileNotFoundError:  # the store works
            self._note("")
            raise
        else:
            self._note("")
        finally:
            if is_trial:
                self._is_tried = False

    def _enter(self) -> bool:
        """Return whether this call tries a store that has failed.

        Raises StoreError if another call tries the store, or if it failed less than PAUSE_SECONDS ago.
        """
        with self._lock:
            if not self._is_unreachable:
                return False
            if self._is_tried or self._clock() < self._failed_at + PAUSE_SECONDS:
                raise StoreError(self.failure)
            self._is_tried = True
            return True

    def _note(self, failure: str, *, is_away: bool = False) -> None:
        with self._lock:
            self.failure, self._is_unreachable, self._failed_at = failure, is_away, self._clock()
