"""The addresses of a host's sockets, and when a client uses them instead of gRPC."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterable
from itertools import islice
from typing import Any

from stampede_rt.cluster.cluster_ids import METADATA_KEY as CLUSTER_KEY
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import Unavailable
from stampede_rt.security.tls import TlsMaterial
from stampede_rt.transports.socket_limits import RETRY_PAUSE_S
from stampede_rt.transports.tcp_route import TcpRoute
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.v1 import socket_stream_pb2
from stampede_rt.wire.stream_frames import PROTOCOL_VERSION

LOCAL_PREFIX = "unix:"
TARGETS_MAX = 4
TICKET_BYTES_MAX = 1024
_OF_HOSTS = re.compile(r"unix:/[^\0]*/[0-9a-f]{16}\.sock")
"""The paths of sockets that hosts make.

A false host must not lead the client to the socket of another program of its user.
"""


class SocketRoute:
    """The sockets of the host at one address."""

    def __init__(self, target: str, transport: Transport, tls: TlsMaterial | None = None) -> None:
        """`tls`: the certificates of the gRPC connection."""
        self._target = target
        self._transport = transport
        self.tcp = TcpRoute(target, tls)
        self._may_use = sys.platform == "linux" and transport is not Transport.GRPC
        self.ticket = b""
        """Proves this client's certificate at the sockets; empty without certificates."""
        self._targets: tuple[str, ...] = ()
        self._is_known = False  # whether the gatekeeper has answered, and the answer still counts
        self._not_before_s = 0.0
        self.shares_memory = False
        """Whether the host shares memory over its sockets."""
        self.late_arrivals = 0
        """The number of late answers of the TCP port. Streams that began over gRPC before should begin anew."""

    def learn(self, endpoints: Iterable[pb.DataEndpoint]) -> None:
        """Keep the gatekeeper's answer: a TCP port, and at most TARGETS_MAX paths of the form that hosts make."""
        answered = list(endpoints)
        local = [one for one in answered if _OF_HOSTS.fullmatch(one.target)] if self._takes_local else []
        sockets = tuple(islice((one for one in local if one.transport == pb.TRANSPORT_SOCKET), TARGETS_MAX))
        self.ticket = sockets[0].ticket[:TICKET_BYTES_MAX] if sockets else b""
        self.shares_memory = any(one.transport == pb.TRANSPORT_SHARED_MEMORY for one in local)
        if self._transport is not Transport.SHARED:
            self.tcp.learn(one.target for one in answered if one.transport == pb.TRANSPORT_SOCKET)
        self._targets = tuple(one.target for one in sockets)
        self._is_known = True  # this line is the last, because from now on other threads use the sockets

    @property
    def _takes_local(self) -> bool:
        return self._transport is not Transport.TCP

    @property
    def may_lead(self) -> bool:
        """Whether the next stream should try a socket.

        A program that has chosen sockets gets Unavailable if there is none.
        """
        return bool(self.targets) or self.offers_tcp or self.must_ask or self.is_forced

    @property
    def is_forced(self) -> bool:
        """Whether the program has chosen sockets, so that gRPC may not replace them."""
        return self._transport in (Transport.SOCKET, Transport.TCP, Transport.SHARED)

    @property
    def must_ask(self) -> bool:
        """Whether to ask the gatekeeper for the host's sockets before the next stream."""
        return self._may_use and not self._is_known and time.monotonic() >= self._not_before_s

    @property
    def targets(self) -> tuple[str, ...]:
        """The Unix sockets to try, best first. Each is "unix:PATH"."""
        return self._targets if self._may_use and self._is_known else ()

    @property
    def offers_tcp(self) -> bool:
        """Whether the next stream may try the TCP port, after the Unix sockets."""
        return self._may_use and self._is_known and self.tcp.port is not None

    def reached(self, port: int, address: str) -> None:
        """Note that the TCP port answers at this IP address. Streams use it from now on."""
        self.tcp.port, self.tcp.address = port, address
        self._is_known = True
        self.late_arrivals += self.tcp.is_slow
        self.tcp.is_slow = False

    def failed(self, why: str) -> None:
        """Note that no socket can be used. The next streams go over gRPC, and after a while the client asks again.

        Raises Unavailable if the program has chosen sockets.
        """
        if not self._is_known or self._targets or self.tcp.port is not None:
            self._is_known = False
            self._not_before_s = time.monotonic() + RETRY_PAUSE_S
        if self.is_forced:
            self._not_before_s = 0.0
            raise Unavailable(
                f"no stream over a socket leads to {self._target}: {why or 'it offers none to this caller'}; "
                f'leave out transport="{self._transport}" to use gRPC'
            )


def memory_not_shared(target: str) -> Unavailable:
    """Return the error for a program that has chosen shared memory at a host that has none."""
    return Unavailable(
        f"the host at {target} shares no memory with this program, which needs Linux on x86-64 at both sides; "
        'leave out transport="shared"'
    )


def opening_of(method: str, metadata: Iterable[tuple[str, str]], ticket: bytes) -> bytes:
    """Return the encoded StreamOpening of a call with the metadata of gRPC calls, and the ticket of its endpoint."""
    named: dict[str, Any] = dict(metadata)
    return socket_stream_pb2.StreamOpening(
        method=method,
        protocol_version=PROTOCOL_VERSION,
        cluster_id=named.get(CLUSTER_KEY, ""),
        authorization=named.get("authorization", ""),
        ticket=ticket,
        trace_parent=named.get("traceparent", ""),
    ).SerializeToString()
