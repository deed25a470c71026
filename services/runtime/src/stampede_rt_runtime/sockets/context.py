"""The context of a stream over a socket. Methods and interceptors of the gRPC server use it as they use gRPC's."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import grpc
from grpc.aio import EOF, AbortError

from stampede_rt.status import DETAILS_KEY
from stampede_rt.v1 import rpc_status_pb2
from stampede_rt_runtime.quotas.working import SOCKET_COSTS
from stampede_rt_runtime.sockets.stream_socket import StreamSocket, TakeInSameTurn

Metadata = tuple[tuple[str, str | bytes], ...]
OK = b""
"""The encoded status of a regular end."""


def status_of(code: grpc.StatusCode, details: str) -> bytes:
    """An encoded google.rpc.Status without an ErrorInfo."""
    return rpc_status_pb2.Status(code=code.value[0], message=details).SerializeToString()


class SocketContext:
    """Reads and writes the messages of one stream, and ends it with a status."""

    costs = SOCKET_COSTS
    takes_parts = True  # see `rpc.takes_parts`

    def __init__(
        self,
        connection: StreamSocket,
        metadata: Metadata,
        peer: str,
        auth: Mapping[str, Sequence[bytes]],
        handler: Any,
    ) -> None:
        """`peer` and `auth` are as gRPC has them. `handler` names the functions that decode and encode messages."""
        self._connection = connection
        self._metadata, self._peer, self._auth = metadata, peer, auth
        self._decode: Callable[[bytes], Any] | None = handler.request_deserializer
        self._encode: Callable[[Any], bytes] | None = handler.response_serializer
        self._trailers: Metadata = ()

    async def read(self) -> Any:
        """The next message, or EOF."""
        raw = await self._connection.read()
        return raw if raw is EOF or self._decode is None else self._decode(raw)

    async def write(self, message: Any) -> None:
        """Write a message. Returns when the system has taken it. Raises InternalError if the caller has gone.

        A method without a serializer may pass the parts of an encoded message.
        """
        await self._connection.write(message if self._encode is None else self._encode(message))

    def answer_in_same_turn(self, take: TakeInSameTurn) -> None:
        """While `read` waits for a message, `take` gets each message first, still encoded. `take` must not wait."""
        self._connection.take_in_same_turn = take

    @property
    def write_now(self) -> Callable[[bytes], None] | None:
        """Writes an encoded message in this turn of the event loop; None while the caller takes no bytes."""
        return self._connection.write_now

    async def write_with_file(self, message: Any, file: int) -> None:
        """Write a short message, and pass an open file with it. `file` is the file's descriptor.

        gRPC's contexts have no such method.

        Raises InternalError if the caller has gone, or takes nothing at present.
        """
        self._connection.write_with_file(message if self._encode is None else self._encode(message), file)

    def __aiter__(self) -> SocketContext:
        """The requests, for methods that iterate over them."""
        return self

    async def __anext__(self) -> Any:
        message = await self.read()
        if message is EOF:
            raise StopAsyncIteration
        return message

    async def abort(
        self, code: grpc.StatusCode, details: str = "", trailing_metadata: Sequence[tuple[str, str | bytes]] = ()
    ) -> NoReturn:
        """End the stream with an error, and raise AbortError."""
        self._trailers = tuple(trailing_metadata)
        encoded = next((value for key, value in self._trailers if key == DETAILS_KEY), None)
        self._connection.end(encoded if isinstance(encoded, bytes) else status_of(code, details))
        raise AbortError("Locally aborted.")

    def invocation_metadata(self) -> Metadata:
        """The credential and the cluster of the caller, as the metadata of a gRPC call."""
        return self._metadata

    def trailing_metadata(self) -> Metadata:
        """The metadata of `abort`."""
        return self._trailers

    def peer(self) -> str:
        """The other side, as gRPC names it."""
        return self._peer

    def auth_context(self) -> Mapping[str, Sequence[bytes]]:
        """The caller's certificate, as gRPC gives it; empty without one."""
        return self._auth
