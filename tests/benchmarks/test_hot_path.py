"""The limits of the benchmark of the hot path."""

from __future__ import annotations

from stampede_rt.transports.grpc_options import CHANNEL_OPTIONS
from tests.benchmarks import bare_server, hot_path


def test_items_on_their_way_to_a_subscriber_fit_into_the_channel() -> None:
    """Otherwise the benchmark would wait for items that retention collected before the benchmark began to read."""
    most = max(hot_path.RUNS * max(hot_path.RUN_ITEMS.values()), *hot_path.INTERVAL_ITEMS.values())
    assert most < hot_path.CHANNEL_ITEMS


def test_the_bare_server_allows_the_pings_of_its_client() -> None:
    """By default a gRPC server allows one ping in 5 minutes on an idle connection. It ends the connection after three
    pings that come too early.
    """
    allowed = dict(bare_server.OPTIONS)["grpc.http2.min_ping_interval_without_data_ms"]
    assert dict(CHANNEL_OPTIONS)["grpc.keepalive_time_ms"] >= 2 * allowed
