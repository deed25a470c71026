"""The limits of the client's gRPC channels. They are the same for asyncio and threads."""

from __future__ import annotations

SUBSCRIBE_METHOD = "/stampede_rt.v1.ChannelService/Subscribe"
PUT_METHOD = "/stampede_rt.v1.ChannelService/Put"
ENQUEUE_METHOD = "/stampede_rt.v1.QueueService/Enqueue"
SILENCE_S_MAX = 15.0  # after this silence a client ends a stream; servers send a sign of life on each stream every 5 s
WAITING_REQUESTS_MAX = 1024  # requests on one stream that the server has not taken yet
END_TIMEOUT_S = 1.0  # the time that the end of a connection waits for its streams to end
MESSAGE_BYTES_MAX = 20 * 1024 * 1024

# A server takes 1024 calls on one connection. gRPC opens further connections for more calls (gRFC A105).
MORE_CONNECTIONS: tuple[tuple[str, int | str], ...] = (
    ("grpc.service_config", '{"connectionScaling": {"maxConnectionsPerSubchannel": 10}}'),
)

CHANNEL_OPTIONS: tuple[tuple[str, int | str], ...] = (
    *MORE_CONNECTIONS,
    ("grpc.max_send_message_length", MESSAGE_BYTES_MAX),
    ("grpc.max_receive_message_length", MESSAGE_BYTES_MAX),
    ("grpc.max_metadata_size", 16 * 1024),
    # The client notices a stopped host by its silence. It does so before a call gives up (10 s), but not before the
    # directory may give the host's channels to another owner (5 s). With grpcio 1.85 only ping_timeout ends the
    # connection. Its default is a minute, and a shorter keepalive_timeout does not change that.
    ("grpc.keepalive_time_ms", 5_000),
    ("grpc.keepalive_timeout_ms", 2_500),
    ("grpc.http2.ping_timeout_ms", 2_500),
    ("grpc.http2.max_pings_without_data", 0),
    ("grpc.keepalive_permit_without_calls", 0),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 3_000),
    ("grpc.max_reconnect_backoff_ms", 1_000),
    ("grpc.enable_http_proxy", 0),
)
