"""Frees what time has outdated in channels that nobody puts to or reads from.

A channel is entered when something has changed in it, and is looked at when it is due: those in which nothing happens
cost nothing, however many they are.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import NoReturn

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.deadlines import Deadlines

ROUND_SECONDS = 0.5
CHANNELS_PER_STEP_MAX = 256
ENTRIES_PER_STEP_MAX = 128
STEPS_PER_RECLAIM = 4


class Sweep:
    """`now` is the host's clock. `looked_at` counts the channels that were asked when they are due, or swept."""

    def __init__(self, now: Callable[[], int]) -> None:
        self._now = now
        self._touched: dict[HostedChannel, None] = {}
        self._deadlines: Deadlines[HostedChannel] = Deadlines()
        self.looked_at = 0

    def touch(self, hosted: HostedChannel) -> None:
        """Something has changed in the channel: it may be due at another time than before."""
        self._touched[hosted] = None

    def forget(self, hosted: HostedChannel) -> None:
        """The channel is not served any more."""
        self._touched.pop(hosted, None)
        self._deadlines.disarm(hosted)

    async def run_forever(self) -> NoReturn:
        """Sweep twice a second."""
        while True:  # paced
            await asyncio.sleep(ROUND_SECONDS)
            await self.sweep()

    async def sweep(self) -> None:
        """Collect what is due, giving way to everybody else in between."""
        while self._step():
            await _give_way()

    def reclaim(self) -> None:
        """Collect what is due, a bounded part, because memory is short: a put waits for it."""
        for _ in range(STEPS_PER_RECLAIM):
            if not self._step():
                return

    def _step(self) -> bool:
        """A bounded part, however many channels have something to free; True if more is left to do at once."""
        freed_entries = 0
        for _ in range(CHANNELS_PER_STEP_MAX):
            hosted = next(iter(self._touched), None) or self._deadlines.pop(self._now())
            if hosted is None:
                return False
            before = hosted.channel.freed_entries
            more = self._look_at(hosted)
            freed_entries += hosted.channel.freed_entries - before
            if more or freed_entries >= ENTRIES_PER_STEP_MAX:
                return True
        return True

    def _look_at(self, hosted: HostedChannel) -> bool:
        """Enter a channel that was touched, or collect what is due in it; True if more is left to collect at once."""
        more = False
        if hosted in self._touched:
            del self._touched[hosted]
        else:
            self.looked_at += 1
            more = hosted.collect(self._now())
        self._enter(hosted)
        return more

    def _enter(self, hosted: HostedChannel) -> None:
        self.looked_at += 1
        due = hosted.next_deadline(self._now())
        if due is None:
            self._deadlines.disarm(hosted)
        else:
            self._deadlines.arm(hosted, due)


async def _give_way() -> None:
    await asyncio.sleep(0)
