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
        """Collect what is due, a bounded part, because memory is short."""
        self._step()

    def _step(self) -> bool:
        """A bounded part; True if more is left to do at once."""
        for _ in range(CHANNELS_PER_STEP_MAX):
            hosted = next(iter(self._touched), None)
            if hosted is not None:
                del self._touched[hosted]
                self._enter(hosted)
            elif (hosted := self._deadlines.pop(self._now())) is not None:
                self.looked_at += 1
                more = hosted.collect(self._now())
                self._enter(hosted)
                if more:
                    return True
            else:
                return False
        return True

    def _enter(self, hosted: HostedChannel) -> None:
        self.looked_at += 1
        due = hosted.next_deadline(self._now())
        if due is None:
            self._deadlines.disarm(hosted)
        else:
            self._deadlines.arm(hosted, due)


async def _give_way() -> None:
    await asyncio.sleep(0)
