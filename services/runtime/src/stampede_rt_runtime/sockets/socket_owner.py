"""The events that the streams over sockets report to their server."""

from __future__ import annotations

from typing import Protocol, TypeVar

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import socket_stream_pb2 as pb

Connection = TypeVar("Connection", contravariant=True)


class SocketOwner(Protocol[Connection]):
    """Learns of the events of its connections."""

    def opened(self, connection: Connection, opening: pb.StreamOpening) -> None:
        """The connection calls this when it has received the opening. May raise a StampedeError."""

    def failed(self, connection: Connection, error: StampedeError) -> None:
        """The connection calls this when the peer has broken the rules of frames. The owner must call `end`."""

    def lost(self, connection: Connection) -> None:
        """The connection calls this when the peer has gone, or when this process has closed the connection."""
