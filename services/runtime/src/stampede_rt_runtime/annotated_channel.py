"""A channel that adds metadata to every call of another channel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import grpc

Metadata = tuple[tuple[str, str], ...]


class AnnotatedChannel(grpc.aio.Channel):
    """A channel that adds metadata to every call of another channel."""

    def __init__(self, inner: grpc.aio.Channel, metadata: Callable[[], Metadata]) -> None:
        self._inner = inner
        self._metadata = metadata

    async def __aenter__(self) -> AnnotatedChannel:
        await self._inner.__aenter__()
        return self

    async def __aexit__(self, *exc_info: Any) -> None:
        await self._inner.__aexit__(*exc_info)

    async def close(self, grace: float | None = None) -> None:
        """Close the connection. Calls under way have `grace` seconds."""
        await self._inner.close(grace)

    def get_state(self, try_to_connect: bool = False) -> grpc.ChannelConnectivity:
        """The state of the connection."""
        return self._inner.get_state(try_to_connect)

    async def wait_for_state_change(self, last_observed_state: grpc.ChannelConnectivity) -> None:
        """Wait until the connection has another state."""
        await self._inner.wait_for_state_change(last_observed_state)

    async def channel_ready(self) -> None:
        """Wait until the connection is made."""
        await self._inner.channel_ready()

    def unary_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and one response."""
        return self._annotated(self._inner.unary_unary(*args, **kwargs))

    def unary_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for one request and a stream of responses."""
        return self._annotated(self._inner.unary_stream(*args, **kwargs))

    def stream_unary(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for a stream of requests and one response."""
        return self._annotated(self._inner.stream_unary(*args, **kwargs))

    def stream_stream(self, *args: Any, **kwargs: Any) -> Any:
        """A callable for streams both ways."""
        return self._annotated(self._inner.stream_stream(*args, **kwargs))

    def _annotated(self, call: Callable[..., Any]) -> Callable[..., Any]:
        def with_more(*args: Any, metadata: Any = None, **kwargs: Any) -> Any:
            return call(*args, metadata=(*(metadata or ()), *self._metadata()) or None, **kwargs)

        return with_more
