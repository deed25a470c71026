"""The last files of former owners, which come to the object store after a channel has moved here."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles

WAIT_SECONDS_MIN, WAIT_SECONDS_MAX = 0.5, 600.0


class _Expected(NamedTuple):
    due: float  # by the clock of the event loop
    wait_s: float


class FormerOwners:
    """Says when to look at the object store: at growing intervals, until the archive of the channel has no hole."""

    def __init__(self) -> None:
        self._expected: dict[MovingFiles, _Expected] = {}

    def expect(self, files: MovingFiles) -> None:
        """Note that the former owner of a channel still has items on its disk."""
        self._expected[files] = _Expected(_clock() + WAIT_SECONDS_MIN, WAIT_SECONDS_MIN)

    def forget(self, files: MovingFiles) -> None:
        """Stop looking for files of a channel."""
        self._expected.pop(files, None)

    def due_s(self) -> float:
        """The seconds until the next look."""
        return min((one.due for one in self._expected.values()), default=float("inf")) - _clock()

    def take_due(self) -> list[MovingFiles]:
        """The channels for which the caller looks now."""
        found = [files for files, one in self._expected.items() if one.due <= _clock()]
        for files in found:
            wait_s = min(2 * self._expected[files].wait_s, WAIT_SECONDS_MAX)
            self._expected[files] = _Expected(_clock() + wait_s, wait_s)
        return found

    def found(self, files: MovingFiles) -> None:
        """Note that the caller has looked. If the archive has no hole any more, this was the last look."""
        if not files.lacks_items():
            self.forget(files)


def _clock() -> float:
    return asyncio.get_running_loop().time()
