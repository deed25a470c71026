"""A gRPC channel that stays usable after a renewal of its certificate. Later calls use a new connection."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import grpc

from stampede_rt.security.tls import TlsMaterial, TlsReader


class _Connection:
    """One connection, and the number of its calls under way."""

    def __init__(self, channel: grpc.aio.Channel) -> None:
        self.channel = channel
        self.calls = 0


class RenewingChannel(grpc.aio.Channel):
    """Uses the present certificate for each new call. Calls under way stay on their connection, even if they last long.

    The channel closes a former connection when its last call has ended. An open connection would reconnect for ever.
    """

    def __init__(self, connect: Callable[[TlsMaterial], grpc.aio.Channel], reader: TlsReader) -> None:
        self._connect = connect
        self._reader = reader
        self._material = reader.current()
        self._newest = _Connection(connect(self._material))
        self._former: set[_Connection] = set()
        self._closing: set[asyncio.Future[None]] = set()  # references, so that no task is collected before its end
        self._closed = False

    @property
    def _channel(self) -> grpc.aio.Channel:
        return self._newest.channel

    def current(self) -> grpc.aio.Channel:
        """The channel for a call that begins now."""
        return self._current().channel

    def _current(self) -> _Connection:
        material = self._reader.current()
        if material is not self._material and not self._closed:
            self._material = material
            former, self._newest = self._newest, _Connection(self._connect(material))
            self._former.add(former)
            self._close_if_unused(former)
        return self._newest

    def _ended(self, connection: _Connection) -> None:
        connection.calls -= 1
        self._close_if_unused(connection)

    def _close_if_unused(self, connection: _Connection) -> None:
        """Close a former connection if it has no calls under way."""
        if connection in self._former and not connection.calls:
            self._former.discard(connection)
            closing = asyncio.ensure_future(connection.channel.close())
            self._closing.add(closing)
            closing.add_done_callback(self._closing.discard)

    async def __aenter__(self) -> RenewingChannel:
        return self

    async def __aexit__(self, *exc_info: Any) -> None:
        await self.close()

    async def close(self, grace: float | None = None) -> None:
        """Close the connections. Calls under way have `grace` seconds. Later calls fail, and nothing reconnects."""
        self._closed = True
        former, self._former = self._former, set()
        for connection in (*former, self._newest):
            await connection.channel.close(grace)

    def get_state(self, try_to_connect: bool = False) -> grpc.ChannelConnectivity:
        """The state of the newest connection."""
        return self._channel.get_state(try_to_connect)

    async def wait_for_state_change(self, last_observed_state: grpc.ChannelConnectivity) -> None:
        """Wait until the newest connection has another state."""
        await self._channel.wait_for_state_change(last_observed_state)

    async def channel_ready(self) -> None:
        """Wait until the newest connection is made."""
        await self._channel.channel_ready()

    def unary_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and one response."""
        return self._renewing(lambda channel: channel.unary_unary(*args, **kwargs))

    def unary_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and a stream of responses."""
        return self._renewing(lambda channel: channel.unary_stream(*args, **kwargs))

    def stream_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for a stream of requests and one response."""
        return self._renewing(lambda channel: channel.stream_unary(*args, **kwargs))

    def stream_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for streams both ways."""
        return self._renewing(lambda channel: channel.stream_stream(*args, **kwargs))

    def _renewing(self, bind: Callable[[grpc.aio.Channel], Callable[..., Any]]) -> Callable[..., Any]:
        bound_to = self._newest
        bound = bind(bound_to.channel)

        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal bound_to, bound
            connection = self._current()
            if connection is not bound_to:
                bound_to, bound = connection, bind(connection.channel)
            grpc_call = bound(*args, **kwargs)
            connection.calls += 1
            grpc_call.add_done_callback(lambda _: self._ended(connection))
            return grpc_call

        return call
