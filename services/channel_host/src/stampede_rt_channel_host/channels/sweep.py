"""Frees what retention has outdated in channels that nobody puts to or reads from."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import NoReturn

from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore

ROUND_SECONDS = 0.5
CHANNELS_PER_STEP_MAX = 256


async def sweep_forever(store: ChannelStore) -> NoReturn:
    """Look at every channel twice a second, a bounded number of them in one go."""
    while True:  # paced
        await asyncio.sleep(ROUND_SECONDS)
        await sweep(store.all(), store.now)


async def sweep(channels: Iterable[HostedChannel], now: Callable[[], int]) -> None:
    """Collect what is due, giving way to everybody else in between."""
    for place, hosted in enumerate(channels):
        if place % CHANNELS_PER_STEP_MAX == CHANNELS_PER_STEP_MAX - 1:
            await _give_way()
        while _collect(hosted, now()):  # each turn frees a bounded part
            await _give_way()


async def _give_way() -> None:
    await asyncio.sleep(0)


def _collect(hosted: HostedChannel, now: int) -> bool:
    """True if more is left to do at once."""
    due = hosted.channel.next_deadline(now)
    return due is not None and due <= now and hosted.channel.collect(now)
