"""Connections between simulated hosts, for calls and for the streams that feed copies. A test can cut the streams."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from grpc.aio import EOF

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.status import error_in
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.fed_responses import read_response

if TYPE_CHECKING:
    from tests.robustness.moves.two_hosts import Host, World


class Connection:
    """A connection from one host to another. Its end breaks its streams."""

    def __init__(self, world: World, source: Host, caller: Host) -> None:
        self.world, self.source, self.caller = world, source, caller
        self._links: list[Link] = []

    def stream_stream(self, method: str, **_: Any) -> Callable[[], Link]:
        """ReplicaService.Feed."""

        def begin() -> Link:
            self._links.append(Link(self.world, self.source, self.caller))
            return self._links[-1]

        return begin

    def unary_unary(self, method: str, **_: Any) -> Callable[..., Any]:
        """BindChannel. The owner calls it at another host, so that a replica begins there."""

        async def bind(request: Any, timeout: float) -> None:  # the signature of a call of gRPC
            await self.source.running.wait()
            with suppress(StampedeError):
                await self.source.store.bind(request.channel_id, request.epoch)

        return bind

    async def close(self, grace: float | None) -> None:
        for link in self._links:
            link.cut()


class Link:
    """A stream from a copy's host, such as the destination, to the source."""

    def __init__(self, world: World, source: Host, caller: Host | None = None) -> None:
        self.world, self.source, self.caller = world, source, caller
        self.is_of_move = False
        self.is_held = False  # the present move has asked for the hold
        self.to_source: asyncio.Queue[Any] = asyncio.Queue()
        self.to_destination: asyncio.Queue[Any] = asyncio.Queue()
        self.serving: asyncio.Task[None] | None = None
        self.is_frozen = False  # the destination reads and writes nothing
        world.links.append(self)

    def cancel(self) -> None:
        self.cut()

    def cut(self) -> None:
        """Break the stream: the source's call is cancelled, and the destination reads an error."""
        if self.serving is not None:
            self.serving.cancel()
        self.to_destination.put_nowait((0.0, Unavailable("the link is cut")))

    def due_s(self) -> float:
        """The time of arrival of a message that is sent now."""
        return asyncio.get_running_loop().time() + self.world.delay_s(self)

    # The destination's side.

    async def write(self, request: pb.FeedRequest) -> None:
        await self._unless_frozen()
        self.check_open()
        if self.serving is None:
            self.serving = asyncio.create_task(self._serve())
        self.is_of_move |= bool(request.open.move_id)
        self.is_held &= not request.HasField("open")
        if request.committed_epoch:
            self.world.at("source learns of the commit")
        if request.released:
            self.world.at("source learns of the release")
        self.world.passes(self)
        self.to_source.put_nowait((self.due_s(), request.SerializeToString()))
        await asyncio.sleep(0)

    def done_writing(self) -> None:
        """End the destination's side."""
        self.to_source.put_nowait((self.due_s(), EOF))

    async def _unless_frozen(self) -> None:
        if self.is_frozen:
            await asyncio.get_running_loop().create_future()
        if self.caller is not None:
            await self.caller.running.wait()

    def check_open(self) -> None:
        """Raises Unavailable if the source cannot be reached."""
        if not self.source.alive or not self.world.reaches(self):
            raise Unavailable("the host does not answer")

    async def read(self) -> Any:
        found = await arrived(self.to_destination)
        await self._unless_frozen()
        if isinstance(found, StampedeError):
            raise found
        if found is EOF:
            return EOF
        response = read_response(found)
        if self.is_of_move:
            self.world.at("handed over" if response.fields.state.HasField("handoff") else "feeding")
        return response

    # The source's side.

    async def _serve(self) -> None:
        try:
            await self.source.servicer.feed(None, Context(self))  # type: ignore[arg-type]
        finally:
            self.to_destination.put_nowait((0.0, EOF))


async def arrived(queue: asyncio.Queue[Any]) -> Any:
    """Wait until the next message of a queue has arrived, and return it."""
    due_s, message = await queue.get()
    if (left_s := due_s - asyncio.get_running_loop().time()) > 0:
        await asyncio.sleep(left_s)
    return message


class Context:
    """The source's side of the stream, as gRPC shows it."""

    def __init__(self, link: Link) -> None:
        self._link = link

    async def read(self) -> Any:
        request = await arrived(self._link.to_source)
        await self._link.source.running.wait()
        if request is not EOF and pb.FeedRequest.FromString(request).hold and not self._link.is_held:
            self._link.is_held = True
            self._link.world.at("held")
        return request

    async def write(self, message: bytes) -> None:
        await self._link.source.running.wait()
        self._link.world.passes(self._link)
        self._link.to_destination.put_nowait((self._link.due_s(), message))
        await asyncio.sleep(0)

    async def abort(self, code: Any, details: str, trailing: Any = ()) -> None:
        self._link.to_destination.put_nowait((0.0, error_in(trailing) or Unavailable(details)))
        raise asyncio.CancelledError
