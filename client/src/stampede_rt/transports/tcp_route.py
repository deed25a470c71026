"""The second TCP port of a host, for streams without gRPC: its address, and the first bytes of a connection to it."""

from __future__ import annotations

import re
import socket
import ssl
from collections.abc import Iterable
from typing import Any, NamedTuple

from stampede_rt.security.tls import TlsMaterial
from stampede_rt.security.tls_contexts import client_context
from stampede_rt.transports.tls_layer import TlsLayer
from stampede_rt.wire.stream_frames import FrameKind, frame_of

GREETING = frame_of(FrameKind.ALIVE)
"""The first frame of a host at a TCP port. It shows the client that the host itself has taken the connection."""
HEAD_START_S = 0.05
"""The time in seconds that the first stream to a host waits for a TCP connection before it uses gRPC."""
REACH_S_MAX = 5.0
"""The time in seconds for which a client tries to reach a port in the background, while its streams use gRPC."""
_OF_HOSTS = re.compile(r"tcp:([1-9][0-9]{0,4})")


class SocketConnection(NamedTuple):
    """A connection to a host for one stream."""

    socket: socket.socket
    is_local: bool = True
    tls: TlsLayer | None = None

    def close(self) -> None:
        """Close the connection."""
        self.socket.close()


class TcpRoute:
    """The TCP port of one host. The name or address of the host comes from gRPC. The gatekeeper gives only the port.

    So a false host cannot lead the client to another machine, and a certificate must name the same host as with gRPC.
    """

    def __init__(self, target: str, tls: TlsMaterial | None) -> None:
        """`target` and `tls`: the address and the certificates of the gRPC connection."""
        self.host = "" if target.startswith("unix:") else target.rpartition(":")[0].strip("[]")
        self._tls = tls
        self._context: ssl.SSLContext | None = None
        self.port: int | None = None
        """The port that the host offers; None: none, as far as the client knows."""
        self.address: str | None = None
        """The IP address at which the client has reached the port; None: it has not."""
        self.is_slow = False
        """Whether an attempt took too long or failed. Then streams do not wait for the next attempt."""
        self.head_start_s: float | None = None
        """The time in seconds that a stream on asyncio waits for a first connection; None: HEAD_START_S."""
        self.reaching: Any = None
        """The last attempt in the background, in the client on asyncio."""

    def learn(self, targets: Iterable[str]) -> None:
        """Keep the first target of the form "tcp:PORT"."""
        found = (_OF_HOSTS.fullmatch(one) for one in targets)
        ports = [int(one[1]) for one in found if one is not None]
        port = ports[0] if ports and ports[0] < 2**16 and self.host else None
        if port != self.port:
            self.address = None
        self.port = port

    def layer(self) -> TlsLayer | None:
        """Return the TLS for a new connection; None without certificates."""
        if self._tls is None:
            return None
        if self._context is None:
            self._context = client_context(self._tls)
        return TlsLayer(self._context, server_name=self.host)


class TcpGreeting:
    """The exchange of client and host before the opening of a stream: the handshake of TLS, and the host's greeting."""

    def __init__(self, tls: TlsLayer | None) -> None:
        self._tls = tls
        self._received = b""
        self._is_secured = tls is None
        self.is_done = False
        """Whether the greeting of the host is complete."""

    def begin(self) -> bytes:
        """Return the first bytes for the host. Raises OSError."""
        return self._continue_handshake()

    def received(self, data: bytes) -> bytes:
        """Take bytes of the host, and return the next bytes for the host.

        Raises OSError if the bytes are not those of a host.
        """
        if not data:
            raise ConnectionResetError("the host has closed the connection")
        if self._tls is None:
            self._received += data
        else:
            self._tls.feed(data)
        answer = self._continue_handshake()
        if self._tls is not None and self._is_secured:
            self._received += _all_of(self._tls)
        if not GREETING.startswith(self._received):
            raise ConnectionRefusedError("the host takes no stream, or it is no host")
        self.is_done = self._received == GREETING
        return answer

    def _continue_handshake(self) -> bytes:
        if self._tls is None or self._is_secured:
            return b""
        self._is_secured = self._tls.continue_handshake()
        return self._tls.to_send()


def _all_of(tls: TlsLayer) -> bytes:
    place = memoryview(bytearray(2**14))
    return bytes(place[: tls.read(place)])


def prepare(connected: socket.socket) -> None:
    """Let a TCP socket send each message immediately.

    A client needs no TCP_USER_TIMEOUT: the signs of life show that the host is there. With TCP_USER_TIMEOUT the system
    would also end the connection to a live host that takes no bytes for a long time, because a put waits for room.
    """
    connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
