"""Watches the directory for changes that concern this host: of groups, of queues, and of the rules of access."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from collections.abc import AsyncGenerator
from typing import NoReturn, Protocol

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import directory_service_pb2
from stampede_rt_channel_host.cluster.records import recorded_change
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_channel_host.core.records import RecordedChange

logger = logging.getLogger(__name__)

CHANGES_PER_TURN = 32  # it takes up to 50 us to log and drop a queue
SILENCE_SECONDS_MAX = 15.0  # signs of life come every 5 s
_PAUSE_SECONDS_MIN, _PAUSE_SECONDS_MAX = 0.2, 5.0


class ChangeFollower(Protocol):
    """A part of the host that follows changes of the directory: its groups, its queues, or its access state."""

    in_use: asyncio.Event
    """Set as soon as this part needs the watch."""

    async def missed(self) -> None:
        """Ask the directory for the present state, because the watch may have missed changes. Raises Unavailable."""

    def changed_in_directory(self, change: RecordedChange) -> None:
        """Process a change of the directory. It may concern things that this host does not use."""


async def watch_forever(
    supernodes: Supernodes, request: directory_service_pb2.WatchRequest, watched: ChangeFollower
) -> NoReturn:
    """Watch without end. Begins as soon as `watched.in_use` is set.

    When the watch breaks, begins again after a pause.
    """
    await watched.in_use.wait()
    pause_s = _PAUSE_SECONDS_MIN
    while True:  # paced by the sleep at the end
        try:
            async with contextlib.aclosing(supernodes.stream("Watch", request)) as responses:
                await _next(responses)
                pause_s = _PAUSE_SECONDS_MIN
                await _pass_on(responses, watched)
        except StampedeError as error:
            logger.info("a watch of the directory broke", extra={"event": "directory_watch_broken", "why": str(error)})
        await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
        pause_s = min(2 * pause_s, _PAUSE_SECONDS_MAX)


async def _pass_on(
    responses: AsyncGenerator[directory_service_pb2.WatchResponse, None], watched: ChangeFollower
) -> NoReturn:
    """Let `watched` ask for the present state, and then pass each change on.

    Raises Unavailable when the stream ends or is silent for SILENCE_SECONDS_MAX.
    """
    await watched.missed()
    while True:  # ends with the stream
        for number, change in enumerate((await _next(responses)).changes, 1):
            watched.changed_in_directory(recorded_change(change))
            if number % CHANGES_PER_TURN == 0:
                await asyncio.sleep(0)


async def _next(
    responses: AsyncGenerator[directory_service_pb2.WatchResponse, None],
) -> directory_service_pb2.WatchResponse:
    try:
        async with asyncio.timeout(SILENCE_SECONDS_MAX):
            return await anext(responses)
    except TimeoutError:
        raise Unavailable(f"the directory gave no sign of life for {SILENCE_SECONDS_MAX:g} s") from None
    except StopAsyncIteration:
        raise Unavailable("the directory ended the watch") from None
