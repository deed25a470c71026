"""The bounds of every gRPC connection, the same on both sides (a server that allows less than a client sends hangs up).

Names and meanings of the options: grpc_types.h of gRPC core.
"""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.transports.grpc_options import MORE_CONNECTIONS
from stampede_rt_runtime.open_files import connections_max

Option = tuple[str, int | str]


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """`concurrent_rpcs_max` calls of anybody are served at a time, `streams_max` of them streams, which may stay open;
    beside them `reserved_rpcs_max` that only parts of the cluster make. A call beyond gets RESOURCE_EXHAUSTED, by gRPC
    itself if more than `refusals_max` are just being refused.

    A server takes messages of `request_bytes_max` at most, and `calls_per_connection_max` calls on one connection;
    callers open further connections for further calls. It closes one that is not set up within `handshake_millis_max`.

    A server hangs up on a peer that pings more often than each `ping_interval_millis_min` while nothing else is sent;
    it must lie well below every caller's keepalive time, or an idle subscription is cut after three pings. The shortest
    keepalive time that a gRPC library takes is 1 s (C core and all on top of it; Go and Java: 10 s).
    """

    message_bytes_max: int = 20 * 2**20
    request_bytes_max: int = 20 * 2**20
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
        """The limits that gRPC gets: for the calls that are served, and for those that are just being refused."""
        return self.concurrent_rpcs_max + self.reserved_rpcs_max + self.refusals_max

    def server_options(self) -> list[Option]:
        """For `grpc.aio.server`. Without so_reuseport=0 a second server would share the port in silence."""
        return [
            *self._shared(self.request_bytes_max),
            ("grpc.so_reuseport", 0),
            ("grpc.max_concurrent_streams", self.calls_per_connection_max),
            ("grpc.server_handshake_timeout_ms", self.handshake_millis_max),
            ("grpc.max_allowed_incoming_connections", connections_max()),
            ("grpc.http2.min_ping_interval_without_data_ms", self.ping_interval_millis_min),
        ]

    def channel_options(self) -> list[Option]:
        """For channels. Reconnects soon: a service that was restarted is found again within about a second."""
        return [
            *self._shared(self.message_bytes_max),
            *MORE_CONNECTIONS,
            ("grpc.initial_reconnect_backoff_ms", 100),
            # How long an attempt may take, whatever the name says: a busy server needs a while to greet many.
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
            ("grpc.http2.ping_timeout_ms", self.keepalive_timeout_millis),  # what ends the connection: see the client's
            ("grpc.keepalive_permit_without_calls", 1),
            ("grpc.http2.max_pings_without_data", 0),
        ]


# For servers that take neither items nor messages: no request of theirs is larger than a piece of a snapshot (1 MiB) or
# a batch of the replicated log.
CONTROL_LIMITS = Limits(request_bytes_max=4 * 2**20)
