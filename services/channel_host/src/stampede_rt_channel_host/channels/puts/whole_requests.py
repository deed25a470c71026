"""Joins the pieces of large requests.

gRPC keeps each message in memory until all of it has come, and Python can set no limit for all streams together. A host
therefore accepts only small messages. A larger request comes in pieces. The first piece states the length of the
request, and the host reads on when it has room for the whole request.

The request keeps its room until `release`, because a joined request may have to wait for the turn of its caller. If the
request gave its room back before, no limit would count its memory: in a test 37 requests of 15 MiB waited in this way.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from typing import Any

from grpc.aio import EOF

from stampede_rt.errors import DeadlineExceeded, InvalidArgument
from stampede_rt.v1 import raw_run_pb2
from stampede_rt.wire.request_pieces import PIECE_TAG, REQUEST_BYTES_MAX, Piece, piece_in
from stampede_rt_channel_host.channels.limits.request_room import RequestRooms
from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.quotas.working import CallerWork

# All pieces of a request must come within this time plus the time that its bytes take at this rate.
JOIN_SECONDS_MIN = 10.0
BYTES_PER_SECOND_MIN = 2**18


class WholeRequests:
    """Reads whole requests from a stream of puts or enqueues."""

    def __init__(self, read: Callable[[], Awaitable[Any]], room: RequestRooms, account: Account) -> None:
        self._read = read
        self._room = room
        self._account = account
        self._work = CallerWork(account)
        self._held = ExitStack()  # the room of the last request that was read
        self.is_joining = False
        """Whether the next message must be a piece of a request."""

    async def read(self) -> Any:
        """The next encoded request, or EOF. Joins a request that comes in pieces. Waits for room for such a request.

        First gives back the room of the last request. Raises InvalidArgument if the pieces do not fit together,
        DeadlineExceeded if they come too slowly, and Overloaded if the caller's quota of bytes in flight is used up.
        See `RequestPiece`.
        """
        self.release()
        raw = await self._read()
        if raw is EOF or raw[:1] != PIECE_TAG:
            return raw
        first = piece_in(raw)
        del raw
        whole_bytes = first.request_bytes
        if not 0 < whole_bytes <= REQUEST_BYTES_MAX:
            raise InvalidArgument(
                f"the first piece announces a request of {whole_bytes} bytes; a request has 1 to {REQUEST_BYTES_MAX} "
                "bytes"
            )
        with ExitStack() as held:
            held.callback(await self._room.take(self._account.subject, whole_bytes))
            held.enter_context(self._account.using(Quota.BYTES_IN_FLIGHT, whole_bytes))
            self.is_joining = True
            whole = await self._join(first, whole_bytes)
            self.is_joining = False  # after an error the stream ends
            self._held = held.pop_all()
            return whole

    def release(self) -> None:
        """Give back the room of the last request: its runs are judged, or other code counts its bytes. Idempotent."""
        self._held.close()

    async def _join(self, first: Piece, whole_bytes: int) -> bytearray:
        """Copy each piece as it comes. So no step copies the whole request, and no piece stays in memory."""
        limit_s, whole = JOIN_SECONDS_MIN + whole_bytes / BYTES_PER_SECOND_MIN, bytearray(first.content)
        try:
            async with asyncio.timeout(limit_s) as limit:
                while len(whole) < whole_bytes:
                    if self._work.must_wait:
                        await self._turn_within(limit)
                    whole += await self._next_content()
        except TimeoutError:
            raise DeadlineExceeded(
                f"{len(whole)} of the {whole_bytes} bytes of a request came within {limit_s:.0f} s; put smaller "
                "items, or use a faster network"
            ) from None
        if len(whole) > whole_bytes:
            raise InvalidArgument(f"the pieces have {len(whole)} bytes, and the first one announced {whole_bytes}")
        return whole

    async def _turn_within(self, limit: asyncio.Timeout) -> None:
        """Wait for the caller's turn before the next piece is read. This wait does not count towards the time limit."""
        loop, ends_at = asyncio.get_running_loop(), limit.when()
        assert ends_at is not None, "a request has a time limit"
        left_s = ends_at - loop.time()
        limit.reschedule(None)
        await self._work.turn()
        limit.reschedule(loop.time() + left_s)

    async def _next_content(self) -> memoryview:
        raw = await self._read()
        if raw is EOF:
            raise InvalidArgument("the stream ended before the last piece of a request")
        piece = piece_in(raw)
        if piece.request_bytes or not piece.content:
            raise InvalidArgument("a piece without content, or a new first piece, came inside a request")
        return piece.content


def check_without_piece(request: raw_run_pb2.RawPutRequest | raw_run_pb2.RawEnqueueRequest) -> None:
    """Raises InvalidArgument for a whole request that also holds a piece of another request."""
    if request.HasField("piece"):
        raise InvalidArgument("a request holds runs and a piece of another request; send the piece in its own request")
