"""Frees items that time has outdated, in channels without puts and reads.

After a change in a channel the sweep notes when the channel is due, and looks at it then. A channel without changes
costs nothing.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable
from typing import NoReturn

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.deadlines import Deadlines

ROUND_SECONDS = 0.5
CHANNELS_PER_STEP_MAX = 32
ENTRIES_PER_STEP_MAX = 64  # a step ends after it has freed this many entries of the indexes of channels


class Sweep:
    """Frees outdated items in the channels of one host.

    `now` is the host's clock. `looked_at` counts the calls of `collect` and `next_deadline` of all channels.
    """

    def __init__(self, now: Callable[[], int]) -> None:
        self._now = now
        # An OrderedDict, because a dict skips the places of all deleted keys each time that it finds its first key.
        self._touched: OrderedDict[HostedChannel, None] = OrderedDict()
        self._deadlines: Deadlines[HostedChannel] = Deadlines()
        self.looked_at = 0

    def touch(self, hosted: HostedChannel) -> None:
        """Note a change in the channel, after which the channel may be due at another time."""
        self._touched[hosted] = None

    def forget(self, hosted: HostedChannel) -> None:
        """Drop a channel that the host no longer serves."""
        self._touched.pop(hosted, None)
        self._deadlines.disarm(hosted)

    async def run_forever(self) -> NoReturn:
        """Sweep twice a second."""
        while True:  # paced by the sleep
            await asyncio.sleep(ROUND_SECONDS)
            await self.sweep()

    async def sweep(self) -> None:
        """Free outdated items in all channels that are due. Lets other tasks run in between."""
        while self._step():
            await _let_others_run()

    def reclaim(self) -> bool:
        """Free some outdated items in one step, because a put needs the memory. Returns True if more may be due now.

        Looks at channels that are due before channels that have changed.
        """
        return self._step(lambda: self._deadlines.pop(self._now()) or next(iter(self._touched), None))

    def _next(self) -> HostedChannel | None:
        return next(iter(self._touched), None) or self._deadlines.pop(self._now())

    def _step(self, next_channel: Callable[[], HostedChannel | None] | None = None) -> bool:
        """Look at some channels, and free some of their items. Returns True if more may be due now.

        `next_channel` returns the next channel to look at, or None. By default changed channels come first.
        """
        freed_entries, next_channel = 0, next_channel or self._next
        for _ in range(CHANNELS_PER_STEP_MAX):
            hosted = next_channel()
            if hosted is None:
                due = self._deadlines.next()
                return due is not None and due <= self._now()  # there were too many changed deadlines for one call
            before = hosted.core.freed_entries
            more = self._look_at(hosted)
            freed_entries += hosted.core.freed_entries - before
            if more or freed_entries >= ENTRIES_PER_STEP_MAX:
                return True
        return True

    def _look_at(self, hosted: HostedChannel) -> bool:
        """Free outdated items, unless the channel has just changed. Note when the channel is due next.

        Returns True if more outdated items are left.
        """
        more = False
        if hosted in self._touched:
            del self._touched[hosted]
        else:
            self.looked_at += 1
            more = hosted.collect(self._now())
        self._note_deadline(hosted)
        return more

    def _note_deadline(self, hosted: HostedChannel) -> None:
        self.looked_at += 1
        due = hosted.next_deadline(self._now())
        if due is None:
            self._deadlines.disarm(hosted)
        else:
            self._deadlines.set_due(hosted, due)


async def _let_others_run() -> None:
    await asyncio.sleep(0)
