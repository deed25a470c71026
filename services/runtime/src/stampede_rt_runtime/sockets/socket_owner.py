"""The events that the streams over sockets report to their server."""

from __future__ import annotations

from typing import Protocol, TypeVar

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import socket_stream_pb2 as pb

Connection = TypeVar("Connection", contravariant=True)


class SocketOwner(Protocol[Connection]):
    """Learns of the events of its connections."""

    def opened(self, connection: Connection, opening: pb.StreamOpening) -> None:
        """Called when the opening has come. May raise a StampedeError."""

    def failed(self, connection: Connection, error: StampedeError) -> None:
        """Called when the peer has broken the rules of frames. The owner must call `end`."""

    def lost(self, connection: Connection) -> None:
        """Called when the peer has gone, or the connection was closed here."""
