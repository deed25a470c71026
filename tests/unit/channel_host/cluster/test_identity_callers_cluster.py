"""A host serves the callers of its cluster, and callers that name no cluster."""

from __future__ import annotations

from pathlib import Path

from stampede_rt.errors import WrongCluster
from stampede_rt_channel_host.cluster.identity import HomeCluster


def test_a_host_refuses_the_callers_of_another_cluster(tmp_path: Path) -> None:
    home = HomeCluster(tmp_path)
    assert home.judge("anybody") is None, "the host is of no cluster yet, and has nothing"
    home.note("x")
    refused = home.judge("y")
    assert isinstance(refused, WrongCluster)
    assert refused.message.startswith("this host is of cluster x, and the caller of cluster y")
    assert HomeCluster(tmp_path).judge("y") is not None


def test_a_host_also_serves_callers_with_the_id_of_the_cluster_that_its_cluster_replaced() -> None:
    home = HomeCluster()
    home.note("x")
    home.note("y", ["x"])
    assert (home.judge("x"), home.judge("y")) == (None, None)
    assert home.judge("z") is not None
