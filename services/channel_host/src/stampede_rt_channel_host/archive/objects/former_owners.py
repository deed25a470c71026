"""Channels whose objects the host must list again: a former owner still moves its last files, or the store was away."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles

WAIT_SECONDS_MIN, WAIT_SECONDS_MAX = 0.5, 600.0


class _ExpectedLook(NamedTuple):
    due: float  # the time of the next look, by the clock of the event loop
    wait_s: float
    is_former: bool


class FormerOwners:
    """Says when to look at the object store: at growing intervals, until the archive of the channel has no hole."""

    def __init__(self) -> None:
        self._expected: dict[MovingFiles, _ExpectedLook] = {}

    def expect(self, files: MovingFiles, *, is_former: bool = True) -> None:
        """Look for the last items of a former owner. `is_former` False: one look is enough."""
        self._expected[files] = _ExpectedLook(_clock() + WAIT_SECONDS_MIN, WAIT_SECONDS_MIN, is_former)

    def hurry(self) -> None:
        """Look for the files of all channels now."""
        self._expected = {files: one._replace(due=0.0) for files, one in self._expected.items()}

    def forget(self, files: MovingFiles) -> None:
        """Stop looking for files of a channel."""
        self._expected.pop(files, None)

    def due_s(self) -> float:
        """The seconds until the next look."""
        return min((one.due for one in self._expected.values()), default=float("inf")) - _clock()

    def take_due(self) -> list[MovingFiles]:
        """The channels whose looks are due. The caller looks for their objects now."""
        found = [files for files, one in self._expected.items() if one.due <= _clock()]
        for files in found:
            one = self._expected[files]
            wait_s = min(2 * one.wait_s, WAIT_SECONDS_MAX)
            self._expected[files] = one._replace(due=_clock() + wait_s, wait_s=wait_s)
        return found

    def found(self, files: MovingFiles, *, lacks_items: bool) -> None:
        """Note that the caller has looked. If the former owner has no more items, this was the last look."""
        one = self._expected.get(files)
        if one is not None and not (one.is_former and lacks_items):
            self.forget(files)


def _clock() -> float:
    return asyncio.get_running_loop().time()
