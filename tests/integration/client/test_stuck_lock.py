"""An interrupt may leave a lock of gRPC locked. Only the interrupted call fails; later calls use a new connection."""

from __future__ import annotations

import pytest

import stampede_rt as st
from stampede_rt.transports.single_thread_call import STREAMS_VARIABLE, SingleThreadCall
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)


@pytest.mark.parametrize("streams", ["", "public"])
def test_calls_after_an_interrupt_that_leaves_a_lock_locked_use_a_new_connection(
    cluster: LocalCluster, streams: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STREAMS_VARIABLE, streams)
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = rt.channel("stuck/a", max_age="60s")
        other = rt.channel("stuck/b", max_age="60s")
        channel.put(b"0")
        other.put(b"0")
        assert channel.newest().payload == b"0"
        [endpoint] = [one for one in rt._session.endpoints._endpoints.values() if hasattr(one._thread_local, "gets")]
        exchange = endpoint.gets()
        call = exchange._call
        lock = call._mutex if isinstance(call, SingleThreadCall) else call._call._state.condition
        lock.acquire()  # as a KeyboardInterrupt within Condition.__enter__ leaves it
        exchange.cancel()
        assert endpoint.is_stuck
        for handle in (channel, other):
            handle.put(b"1")
            assert handle.newest().payload == b"1"
        assert endpoint not in rt._session.endpoints._endpoints.values()
