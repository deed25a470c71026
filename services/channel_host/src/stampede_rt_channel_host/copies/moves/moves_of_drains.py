"""The destination's side of `MigrationService.MoveEachHere`: another host that drains names its channels."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.status import to_error_message
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.credit import requests_of
from stampede_rt_runtime.rpc import Context

NAMED_MAX = 32  # channels in one request
UNANSWERED_MAX = 128  # channels of one stream; the host reads no further request meanwhile


class MovesOfDrain:
    """One stream. `move` makes this host the owner of a channel."""

    def __init__(self, stream: OpenStream, context: Context, move: Callable[[bytes], Awaitable[object]]) -> None:
        self._stream = stream
        self._context = context
        self._move = move
        self._room = asyncio.Semaphore(UNANSWERED_MAX)
        self._moves: set[asyncio.Task[None]] = set()
        self._under_way: set[bytes] = set()  # the channels of these moves
        self._outcomes: list[pb.MoveOutcome] = []
        self._wakeup = asyncio.Event()
        self._is_closed = False  # the caller names no further channels

    async def run(self) -> None:
        """Answer all requests. Outcomes that come during one write go out together."""
        reading = self._stream.spawn(self._read())
        try:
            while not self._is_closed or self._moves or self._outcomes:
                await self._wakeup.wait()
                self._wakeup.clear()
                outcomes, self._outcomes = self._outcomes, []
                if outcomes:
                    await self._context.write(pb.MoveEachHereResponse(outcomes=outcomes))
                for _ in outcomes:
                    self._room.release()
        finally:
            for task in (reading, *self._moves):
                task.cancel()

    async def _read(self) -> None:
        async for request in requests_of(self._context.read):
            if len(request.channel_ids) > NAMED_MAX:
                raise InvalidArgument(
                    f"the request names {len(request.channel_ids)} channels; name {NAMED_MAX} at most"
                )
            for channel_id in request.channel_ids:
                if channel_id in self._under_way:  # the caller asks again every 2 s; one outcome answers all
                    continue
                await self._room.acquire()
                self._under_way.add(channel_id)
                move = self._stream.spawn(self._move_one(channel_id))
                self._moves.add(move)
                move.add_done_callback(self._over)
        self._is_closed = True
        self._wakeup.set()

    async def _move_one(self, channel_id: bytes) -> None:
        outcome = pb.MoveOutcome(channel_id=channel_id)
        try:
            await self._move(channel_id)
        except StampedeError as error:
            outcome.error.CopyFrom(to_error_message(error))
        self._under_way.discard(channel_id)
        self._outcomes.append(outcome)

    def _over(self, move: asyncio.Task[None]) -> None:
        self._moves.discard(move)
        self._wakeup.set()
