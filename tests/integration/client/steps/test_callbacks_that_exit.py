"""A function that calls `sys.exit` ends its callback or sampler. The handle reports this."""

from __future__ import annotations

import sys
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 10.0


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_function_that_exits_ends_its_handle_with_an_error(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("exits/left", max_age="60s")

        def leave(*_: Any) -> None:
            sys.exit(3)

        listener, sampler = channel.on_item(leave), channel.sample(leave, every="1ms")
        channel.put(b"x")
        for handle in (listener, sampler):
            assert handle.join(LIMIT_S)
            assert not handle.active
            assert str(handle.error) == "its function raised SystemExit(3)"
    assert sum("has ended: its function raised SystemExit(3)" in one.getMessage() for one in caplog.records) == 2
