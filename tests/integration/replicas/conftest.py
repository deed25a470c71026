"""The cluster of the tests of replicas."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import running_cluster


@pytest.fixture
def feeds(request: pytest.FixtureRequest) -> str:
    """The transport of the feeds of a test's hosts: the test's parameter `feeds`, or else the best transport."""
    return getattr(request, "param", "best")


@pytest.fixture
def three_hosts(feeds: str) -> Iterator[LocalCluster]:
    """A cluster of three hosts for one test, which may kill them."""
    with running_cluster(hosts=3, supernodes=1, data_ports=True, feed_transport=feeds) as made:
        yield made
