"""The limits of the gRPC servers of services, and of the connections that services open.

Both are in one module because they must fit together: a server closes a connection whose caller pings too often.

The names and meanings of the options are in gRPC core's grpc_types.h.
"""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.transports.grpc_options import MORE_CONNECTIONS
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX as REQUEST_MESSAGE_BYTES_MAX
from stampede_rt.wire.request_pieces import SOCKET_MESSAGE_BYTES_MAX
from stampede_rt_runtime.open_files import connections_max

Option = tuple[str, int | str]


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """The limits of a server and its connections.

    A server serves `concurrent_rpcs_max` calls at a time. `streams_max` of them may be streams, which may stay open. In
    addition it serves `reserved_rpcs_max` calls that only services of the cluster and operators may make. It refuses
    further calls with RESOURCE_EXHAUSTED. While it is refusing `refusals_max` calls, gRPC itself refuses all others.

    Neither side sends a message of more than `message_bytes_max`, and no client accepts such a message. A server
    accepts messages of `request_bytes_max` at most, or of `socket_request_bytes_max` over a socket. On each stream it
    accepts `unread_bytes_max` more bytes before it reads them. It accepts `calls_per_connection_max` calls on one
    connection. Callers open further connections for further calls. The server closes a connection whose set-up takes
    longer than `handshake_millis_max`. Each side pings the other after `keepalive_millis` of silence, and closes the
    connection if no answer comes within `keepalive_timeout_millis`.

    A server closes a connection whose peer pings more often than every `ping_interval_millis_min` while nothing else is
    sent. This value must be well below every caller's keepalive time. Otherwise an idle subscription breaks after three
    pings. The shortest keepalive time of a gRPC library is 1 s (C core and libraries on it; Go and Java: 10 s).
    """

    message_bytes_max: int = 20 * 2**20
    request_bytes_max: int = REQUEST_MESSAGE_BYTES_MAX
    socket_request_bytes_max: int = SOCKET_MESSAGE_BYTES_MAX
    unread_bytes_max: int = 2**18
    metadata_bytes_max: int = 16 * 2**10
    concurrent_rpcs_max: int = 4608
    streams_max: int = 4096
    reserved_rpcs_max: int = 512
    refusals_max: int = 256
    calls_per_connection_max: int = 1024
    handshake_millis_max: int = 10_000
    keepalive_millis: int = 20_000
    keepalive_timeout_millis: int = 10_000
    ping_interval_millis_min: int = 500
    reconnect_millis_max: int = 1_000

    def rpcs_max(self) -> int:
        """gRPC's own limit: the served calls, and the calls that the server is refusing."""
        return self.concurrent_rpcs_max + self.reserved_rpcs_max + self.refusals_max

    def server_options(self) -> list[Option]:
        """The options of `grpc.aio.server`. Without so_reuseport=0 a second server would silently share the port."""
        return [
            *self._shared(self.request_bytes_max),
            ("grpc.so_reuseport", 0),
            ("grpc.max_concurrent_streams", self.calls_per_connection_max),
            ("grpc.server_handshake_timeout_ms", self.handshake_millis_max),
            ("grpc.max_allowed_incoming_connections", connections_max()),
            ("grpc.http2.min_ping_interval_without_data_ms", self.ping_interval_millis_min),
            # With the probe, gRPC lets a fast caller send up to 64 MiB on each stream that the service does not read.
            ("grpc.http2.bdp_probe", 0),
            ("grpc.http2.lookahead_bytes", self.unread_bytes_max),
        ]

    def channel_options(self) -> list[Option]:
        """The options of channels. A channel reconnects soon: within about a second after a service was restarted."""
        return [
            *self._shared(self.message_bytes_max),
            *MORE_CONNECTIONS,
            ("grpc.initial_reconnect_backoff_ms", 100),
            # The time limit of a connection attempt, in spite of its name: a busy server takes a while to greet many
            # clients.
            ("grpc.min_reconnect_backoff_ms", self.reconnect_millis_max),
            ("grpc.max_reconnect_backoff_ms", self.reconnect_millis_max),
            ("grpc.use_local_subchannel_pool", 1),
            ("grpc.enable_http_proxy", 0),
        ]

    def _shared(self, received_bytes_max: int) -> list[Option]:
        return [
            ("grpc.max_send_message_length", self.message_bytes_max),
            ("grpc.max_receive_message_length", received_bytes_max),
            ("grpc.max_metadata_size", self.metadata_bytes_max),
            ("grpc.absolute_max_metadata_size", 2 * self.metadata_bytes_max),
            ("grpc.keepalive_time_ms", self.keepalive_millis),
            ("grpc.keepalive_timeout_ms", self.keepalive_timeout_millis),
            # the option that ends a silent connection; see grpc_options of the client
            ("grpc.http2.ping_timeout_ms", self.keepalive_timeout_millis),
            ("grpc.keepalive_permit_without_calls", 1),
            ("grpc.http2.max_pings_without_data", 0),
        ]


# For servers that accept neither items nor messages. Their largest requests are a piece of a snapshot (1 MiB) and a
# batch of the replicated log.
CONTROL_LIMITS = Limits(request_bytes_max=4 * 2**20)
