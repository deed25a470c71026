"""The streams that feed the moves to one host. A stream carries one move after the other."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import grpc

from stampede_rt_channel_host.copies.feed_calls import feed_over
from stampede_rt_channel_host.copies.moves.move_slots import MOVES_MAX

FREE_SECONDS = 1.0  # a stream without a move ends after this time; the source keeps it for longer


class MoveStream:
    """One stream to a source. `is_new`: it has carried no move yet."""

    def __init__(self, target: str, channel: grpc.aio.Channel) -> None:
        self.target = target
        self.call: Any = feed_over(channel)
        self.is_new = True
        self._channel = channel
        self._timer: asyncio.TimerHandle | None = None

    def keep(self, end: Callable[[MoveStream], None]) -> None:
        """Call `end` with this stream after FREE_SECONDS."""
        self.is_new = False
        self._timer = asyncio.get_running_loop().call_later(FREE_SECONDS, end, self)

    def use(self) -> None:
        """Note that the next move has begun."""
        if self._timer is not None:
            self._timer.cancel()

    async def aclose(self) -> None:
        """End the stream."""
        self.use()
        self.call.cancel()
        await self._channel.close(None)


class MoveStreams:
    """The streams of one host, on its event loop. At most MOVES_MAX of them wait for a move."""

    def __init__(self, dial: Callable[[str], grpc.aio.Channel]) -> None:
        """`dial` opens connections to other hosts."""
        self._dial = dial
        self._free: defaultdict[str, list[MoveStream]] = defaultdict(list)  # by target
        self._ending: set[asyncio.Task[None]] = set()

    def new(self, target: str) -> MoveStream:
        """A new stream to the host at `target`."""
        return MoveStream(target, self._dial(target))

    def free(self, target: str) -> MoveStream:
        """A stream to the host at `target`: a free one if there is one."""
        if target not in self._free:
            return self.new(target)
        stream = self._free[target][-1]
        stream.use()
        self._remove(stream)
        return stream

    async def give_back(self, stream: MoveStream, *, is_free: bool) -> None:
        """End a stream after its move. Keep it for the next move if the source has said that it is free."""
        if is_free and sum(map(len, self._free.values())) < MOVES_MAX:
            self._free[stream.target].append(stream)
            stream.keep(self._end)
        else:
            await stream.aclose()

    def _remove(self, stream: MoveStream) -> None:
        free = self._free[stream.target]
        free.remove(stream)
        if not free:
            del self._free[stream.target]

    def _end(self, stream: MoveStream) -> None:
        self._remove(stream)
        ending = asyncio.create_task(stream.aclose(), name="end of a stream of moves")
        self._ending.add(ending)
        ending.add_done_callback(self._ending.discard)

    async def aclose(self) -> None:
        """End all free streams."""
        free, self._free = self._free, defaultdict(list)
        await asyncio.gather(*(one.aclose() for streams in free.values() for one in streams), *self._ending)
