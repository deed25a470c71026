"""A channel that outlives its certificate: calls that begin after a renewal go over a new connection."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import grpc

from stampede_rt.tls import TlsMaterial, TlsReader


class RenewingChannel(grpc.aio.Channel):
    """Looks at the certificate files at each call. Calls under way stay where they are, for one renewal at least."""

    def __init__(self, connect: Callable[[TlsMaterial], grpc.aio.Channel], reader: TlsReader) -> None:
        self._connect = connect
        self._reader = reader
        self._material = reader.current()
        self._channel = connect(self._material)
        self._former: grpc.aio.Channel | None = None
        self._let_go: asyncio.Future[None] | None = None  # held, so that it is not collected before it is done
        self._closed = False

    def current(self) -> grpc.aio.Channel:
        """The channel for a call that begins now."""
        material = self._reader.current()
        if material is not self._material and not self._closed:
            self._material = material
            if self._former is not None:
                self._let_go = asyncio.ensure_future(self._former.close())  # it would go on connecting for ever
            self._former, self._channel = self._channel, self._connect(material)
        return self._channel

    async def __aenter__(self) -> RenewingChannel:
        return self

    async def __aexit__(self, *exc_info: Any) -> None:
        await self.close()

    async def close(self, grace: float | None = None) -> None:
        """Close the connections; calls under way have `grace` seconds. Later calls fail; nothing connects again."""
        self._closed = True
        for channel in (self._former, self._channel):
            if channel is not None:
                await channel.close(grace)

    def get_state(self, try_to_connect: bool = False) -> grpc.ChannelConnectivity:
        """The state of the newest connection."""
        return self._channel.get_state(try_to_connect)

    async def wait_for_state_change(self, last_observed_state: grpc.ChannelConnectivity) -> None:
        """Return when that state is another one."""
        await self._channel.wait_for_state_change(last_observed_state)

    async def channel_ready(self) -> None:
        """Return when the newest connection stands."""
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
        bound_to = self._channel
        bound = bind(bound_to)

        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal bound_to, bound
            channel = self.current()
            if channel is not bound_to:
                bound_to, bound = channel, bind(channel)
            return bound(*args, **kwargs)

        return call
