"""Connections that an event loop on a separate thread can use.

grpc.aio sends the events of all event loops of a process through one queue, so a blocked loop blocks the others, too.
This module uses gRPC's blocking channel instead, which has threads of its own. Any event loop can await a call.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import grpc

from stampede_rt.security.tls import TlsMaterial, TlsReader

Connect = Callable[[TlsMaterial | None], grpc.Channel]


class AnyLoopChannel(grpc.aio.Channel):
    """Unary calls that any event loop can await. Each call uses a connection with the present certificate.

    `metadata` goes with every call. There are no streams. Make one call at a time: after a renewal of the certificate,
    a new call ends the calls under way on the former connection.
    """

    def __init__(self, connect: Connect, metadata: tuple[tuple[str, str], ...], reader: TlsReader | None) -> None:
        self._connect = connect
        self._metadata = metadata
        self._reader = reader
        self._material = self._read()
        self._channel = connect(self._material)

    async def __aenter__(self) -> AnyLoopChannel:
        return self

    async def __aexit__(self, *exc_info: Any) -> None:
        await self.close()

    async def close(self, grace: float | None = None) -> None:
        """Close the connection. Calls under way fail."""
        self._channel.close()

    def get_state(self, try_to_connect: bool = False) -> grpc.ChannelConnectivity:
        """Raises NotImplementedError: this channel does not offer it."""
        raise NotImplementedError("make a call: its status shows the state of the connection")

    async def wait_for_state_change(self, last_observed_state: grpc.ChannelConnectivity) -> None:
        """Raises NotImplementedError: this channel does not offer it."""
        raise NotImplementedError("make a call: its status shows the state of the connection")

    async def channel_ready(self) -> None:
        """Raises NotImplementedError: this channel does not offer it."""
        raise NotImplementedError("make a call: its status shows the state of the connection")

    def unary_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and one response."""

        async def call(
            request: Any, timeout: float | None = None, metadata: Sequence[tuple[str, str]] | None = None
        ) -> Any:
            method: Any = self._current().unary_unary(*args, **kwargs)
            sent = (*self._metadata, *(metadata or ())) or None
            return await _awaited(method.future(request, timeout=timeout, metadata=sent))

        return call

    def unary_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable that always fails: stubs need such a callable, but this channel has no streams."""
        return _no_streams

    stream_unary = stream_stream = unary_stream

    def _current(self) -> grpc.Channel:
        material = self._read()
        if material is not self._material:
            former, self._material, self._channel = self._channel, material, self._connect(material)
            former.close()
        return self._channel

    def _read(self) -> TlsMaterial | None:
        return None if self._reader is None else self._reader.current()


def _no_streams(*args: Any, **kwargs: Any) -> Any:
    raise NotImplementedError("this connection carries single calls only")


async def _awaited(call: Any) -> Any:
    """The call's response. Raises grpc.RpcError. A cancellation cancels the call."""
    loop = asyncio.get_running_loop()
    done: asyncio.Future[None] = loop.create_future()

    def settle() -> None:
        if not done.done():
            done.set_result(None)

    def ended(_call: Any) -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(settle)

    call.add_done_callback(ended)
    try:
        await done
    except asyncio.CancelledError:
        call.cancel()
        raise
    return call.result()
