"""Hears from the directory what becomes of the queues that are used here: changed set-ups, deletions, new owners."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
from collections.abc import Awaitable, Callable, Iterable
from typing import NoReturn, Protocol

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import directory_pb2, directory_service_pb2, queue_pb2
from stampede_rt_channel_host.cluster.supernodes import Supernodes

logger = logging.getLogger(__name__)

SILENCE_SECONDS_MAX = 15.0  # signs of life come every 5 s
_PAUSE_SECONDS_MIN, _PAUSE_SECONDS_MAX = 0.2, 5.0


class WatchedQueues(Protocol):
    """The queues of a host, as the watch knows them."""

    in_use: asyncio.Event

    def ids(self) -> Iterable[bytes]:
        """Those that are used here."""

    async def check(self, queue_id: bytes) -> None:
        """Ask the directory about one whose changes may have been missed. Raises Unavailable."""

    def changed(self, record: queue_pb2.QueueRecord, *, removed: bool) -> None:
        """The directory tells of a change."""


async def watch_queues_forever(supernodes: Supernodes, queues: WatchedQueues) -> NoReturn:
    """Begins when a queue is used here for the first time; begins anew whenever the watch breaks."""
    await queues.in_use.wait()
    pause_s = _PAUSE_SECONDS_MIN
    while True:  # paced
        try:
            await _watch(supernodes, queues)
        except StampedeError as error:
            logger.info("the watch of queues broke", extra={"why": str(error)})
        await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
        pause_s = min(2 * pause_s, _PAUSE_SECONDS_MAX)


async def _watch(supernodes: Supernodes, queues: WatchedQueues) -> None:
    """Until the stream ends. What changed before it began is asked for."""
    request = directory_service_pb2.WatchRequest(include_queues=True)
    async with contextlib.aclosing(supernodes.stream("Watch", request)) as responses:
        await _next(responses.__anext__)
        for queue_id in list(queues.ids()):
            await queues.check(queue_id)
        while True:  # ends with the stream
            response: directory_service_pb2.WatchResponse = await _next(responses.__anext__)
            for change in response.changes:
                if change.HasField("queue"):
                    removed = change.kind == directory_pb2.CHANGE_KIND_REMOVED
                    queues.changed(change.queue, removed=removed)


async def _next(
    read: Callable[[], Awaitable[directory_service_pb2.WatchResponse]],
) -> directory_service_pb2.WatchResponse:
    try:
        async with asyncio.timeout(SILENCE_SECONDS_MAX):
            return await read()
    except TimeoutError:
        raise Unavailable(f"the directory said nothing for {SILENCE_SECONDS_MAX:g} s") from None
    except StopAsyncIteration:
        raise Unavailable("the directory ended the watch") from None
