"""The RPCs with streams in both directions, which can also go over sockets."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class BidiMethod:
    """One RPC: its full name, the functions that encode and decode its messages, and the method of gRPC.

    A function is None if the program sends or gets encoded messages. `decode` may get a view, and keeps no part of it.
    """

    __slots__ = ("decode", "encode", "name", "over_grpc")

    def __init__(
        self,
        name: str,
        encode: Callable[[Any], bytes] | None,
        decode: Callable[[Any], Any] | None,
        over_grpc: Callable[..., Any],
    ) -> None:
        self.name, self.encode, self.decode, self.over_grpc = name, encode, decode, over_grpc

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Begin a call over gRPC."""
        return self.over_grpc(*arguments, **named)


class BidiMethods:
    """A gRPC channel that makes BidiMethods for stubs. All other methods are gRPC's."""

    def __init__(self, channel: Any) -> None:
        self._channel = channel

    def stream_stream(
        self,
        name: str,
        request_serializer: Callable[[Any], bytes] | None = None,
        response_deserializer: Callable[[bytes], Any] | None = None,
        **options: Any,
    ) -> BidiMethod:
        """Return the RPC `name`."""
        over_grpc = self._channel.stream_stream(name, request_serializer, response_deserializer, **options)
        return BidiMethod(name, request_serializer, response_deserializer, over_grpc)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._channel, name)
