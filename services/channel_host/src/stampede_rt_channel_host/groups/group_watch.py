"""Hears from the directory what becomes of the groups that are read here: their members, their ends, new owners."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from collections.abc import AsyncGenerator
from typing import NoReturn, Protocol

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import directory_pb2, directory_service_pb2
from stampede_rt_channel_host.cluster.supernodes import Supernodes

logger = logging.getLogger(__name__)

SILENCE_SECONDS_MAX = 15.0  # signs of life come every 5 s
_PAUSE_SECONDS_MIN, _PAUSE_SECONDS_MAX = 0.2, 5.0


class WatchedGroups(Protocol):
    """The groups of a host, as the watch knows them."""

    in_use: asyncio.Event

    def missed(self) -> None:
        """Changes may have been missed: look all groups up."""

    def changed_in_directory(self, change: directory_pb2.DirectoryChange) -> None:
        """The directory tells of a change, be it of no concern here."""


async def watch_groups_forever(supernodes: Supernodes, groups: WatchedGroups) -> NoReturn:
    """Begins when a group is used here for the first time; begins anew whenever the watch breaks."""
    await groups.in_use.wait()
    pause_s = _PAUSE_SECONDS_MIN
    while True:  # paced
        try:
            await _watch(supernodes, groups)
        except StampedeError as error:
            logger.info("the watch of groups broke", extra={"why": str(error)})
        await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
        pause_s = min(2 * pause_s, _PAUSE_SECONDS_MAX)


async def _watch(supernodes: Supernodes, groups: WatchedGroups) -> None:
    """Until the stream ends."""
    request = directory_service_pb2.WatchRequest(include_groups=True)
    async with contextlib.aclosing(supernodes.stream("Watch", request)) as responses:
        await _next(responses)
        groups.missed()
        while True:  # ends with the stream
            for change in (await _next(responses)).changes:
                groups.changed_in_directory(change)


async def _next(
    responses: AsyncGenerator[directory_service_pb2.WatchResponse, None],
) -> directory_service_pb2.WatchResponse:
    try:
        async with asyncio.timeout(SILENCE_SECONDS_MAX):
            return await anext(responses)
    except TimeoutError:
        raise Unavailable(f"the directory said nothing for {SILENCE_SECONDS_MAX:g} s") from None
    except StopAsyncIteration:
        raise Unavailable("the directory ended the watch") from None
