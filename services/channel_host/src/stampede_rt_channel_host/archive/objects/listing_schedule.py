"""Says when the host lists the objects of a channel again.

The host does so while a former owner of the channel still moves its last files to the object store, and once after the
store was not available.
"""

from __future__ import annotations

import asyncio
from typing import NamedTuple

from stampede_rt_channel_host.archive.objects.moving_files import MovingFiles

WAIT_SECONDS_MIN, WAIT_SECONDS_MAX = 0.5, 600.0


class _NextListing(NamedTuple):
    due: float  # the time of the next listing, by the clock of the event loop
    wait_s: float
    is_former: bool


class ListingSchedule:
    """The times of the next listings: at growing intervals, until the archive of a channel lacks no item."""

    def __init__(self) -> None:
        self._expected: dict[MovingFiles, _NextListing] = {}

    def expect(self, files: MovingFiles, *, is_former: bool = True) -> None:
        """Plan listings of a channel's objects, until the last items of its former owner are there.

        `is_former` False: plan one listing, because the channel has no former owner that still moves files.
        """
        self._expected[files] = _NextListing(_clock() + WAIT_SECONDS_MIN, WAIT_SECONDS_MIN, is_former)

    def hurry(self) -> None:
        """Make the listings of all channels due now."""
        self._expected = {files: one._replace(due=0.0) for files, one in self._expected.items()}

    def forget(self, files: MovingFiles) -> None:
        """Drop the plan for a channel."""
        self._expected.pop(files, None)

    def due_s(self) -> float:
        """The seconds until the next listing."""
        return min((one.due for one in self._expected.values()), default=float("inf")) - _clock()

    def take_due(self) -> list[MovingFiles]:
        """Return the channels whose listings are due. The caller lists their objects now."""
        due = [files for files, one in self._expected.items() if one.due <= _clock()]
        for files in due:
            one = self._expected[files]
            wait_s = min(2 * one.wait_s, WAIT_SECONDS_MAX)
            self._expected[files] = one._replace(due=_clock() + wait_s, wait_s=wait_s)
        return due

    def note_listed(self, files: MovingFiles, *, lacks_items: bool) -> None:
        """Note a listing by the caller. Listings go on only while the archive lacks items of a former owner."""
        one = self._expected.get(files)
        if one is not None and not (one.is_former and lacks_items):
            self.forget(files)


def _clock() -> float:
    return asyncio.get_running_loop().time()
