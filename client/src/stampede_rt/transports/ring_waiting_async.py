"""Waits for changes of rings in the client on asyncio. One thread waits for all rings of a connection.

The thread begins with the first wait, and ends when no caller has waited for a while.
"""

from __future__ import annotations

import asyncio
import ctypes
import threading
from contextlib import suppress

from stampede_rt.transports import futexes
from stampede_rt.transports.ring_mapping import WAIT_S_MAX, RingMapping


class _Wait:
    """One caller that waits for a ring."""

    __slots__ = ("changes", "future", "loop", "mapping")

    def __init__(self, mapping: RingMapping, changes: int) -> None:
        self.mapping, self.changes = mapping, changes
        self.loop = asyncio.get_running_loop()
        self.future: asyncio.Future[None] = self.loop.create_future()

    def wake(self) -> None:
        with suppress(RuntimeError):  # the loop has ended
            self.loop.call_soon_threadsafe(self._done)

    def _done(self) -> None:
        if not self.future.done():
            self.future.set_result(None)


class RingWaits:
    """Waits for rings."""

    def __init__(self) -> None:
        self._waits: dict[_Wait, None] = {}
        self._mutex = threading.Lock()  # guards the waits and the thread
        self._has_thread = self._is_unavailable = False
        self._wakeup = ctypes.c_uint32(0)  # changes when the thread must look at the waits again

    @property
    def waiting(self) -> int:
        """The number of callers that wait."""
        return len(self._waits)

    async def wait(self, mapping: RingMapping, changes: int, timeout_s: float) -> bool:
        """Wait until the ring changes, for at most `timeout_s` and WAIT_S_MAX.

        Returns False immediately if the thread can wait for no further ring. `changes` is the number of changes before
        the caller's last look.
        """
        wait = _Wait(mapping, changes)
        with self._mutex:
            rings = {one.mapping for one in self._waits} | {mapping}
            if self._is_unavailable or len(rings) >= futexes.WORDS_MAX:
                return False
            self._waits[wait] = None
            if not self._has_thread:
                self._has_thread = True
                threading.Thread(target=self._run, name="stampede waits for rings", daemon=True).start()
            self._wake_thread()
        try:
            async with asyncio.timeout(min(timeout_s, WAIT_S_MAX)):
                await wait.future
        except TimeoutError:
            pass
        finally:
            with self._mutex:
                self._waits.pop(wait, None)
        return True

    def wake(self, mapping: RingMapping) -> None:
        """End all waits for a ring, so that their callers look again."""
        with self._mutex:
            for wait in [one for one in self._waits if one.mapping is mapping]:
                del self._waits[wait]
                wait.wake()

    def close(self) -> None:
        """End all waits."""
        with self._mutex:
            for wait in self._waits:
                wait.wake()
            self._waits.clear()
            self._wake_thread()

    def _wake_thread(self) -> None:
        self._wakeup.value = (self._wakeup.value + 1) & 0xFFFF_FFFF
        futexes.wake(ctypes.addressof(self._wakeup))

    def _run(self) -> None:
        is_idle = False
        while True:
            with self._mutex:
                if is_idle and not self._waits:
                    self._has_thread = False
                    return
                words = self._words()
                is_idle = not self._waits
            try:
                futexes.wait_for_any(words, WAIT_S_MAX)
            except OSError:  # the system has no such call: from now on `wait` returns False
                self._is_unavailable = True
                self.close()
                return

    def _words(self) -> list[tuple[int, int]]:
        """Wake the callers whose ring has changed.

        Returns the words for which the other callers wait. The caller of this method has the mutex.
        """
        words = {ctypes.addressof(self._wakeup): self._wakeup.value}
        for wait in [*self._waits]:
            if wait.mapping.changes != wait.changes:
                del self._waits[wait]
                wait.wake()
            else:
                words[wait.mapping.changes_address] = wait.changes
        return [*words.items()]
