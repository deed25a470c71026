"""The contract's essentials over mutual TLS: the same tests as elsewhere, on a cluster with certificates and rules."""

# ruff: noqa: F401  # the tests come from tests/contract, and take this file's fixture
from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_runtime.identity import Role
from tests.contract.surfaces import Surface
from tests.contract.test_access import (
    Scene,
    prepared,
    test_an_open_stream_ends_when_the_rule_that_allows_it_is_removed,
    test_each_verb_is_denied_without_a_rule_and_succeeds_with_it,
)
from tests.contract.test_puts import (
    test_a_producer_keeps_order_and_loses_nothing,
    test_a_put_earlier_than_an_advance_is_too_old,
    test_max_items_drops_the_oldest,
    test_seqs_grow_by_one,
)
from tests.contract.test_reads import (
    test_a_limit_keeps_the_earliest_items_and_the_next_page_continues,
    test_an_item_keeps_the_time_and_attributes_of_its_producer,
    test_items_are_ordered_by_time_and_not_by_arrival,
)
from tests.contract.test_subscriptions import (
    test_a_newest_subscription_never_goes_back_and_counts_skipped_items,
    test_a_subscription_yields_each_item_once_however_puts_and_reads_interleave,
)
from tests.contract.test_waiting import (
    test_a_blocking_get_is_released_by_the_first_matching_item,
    test_a_cancelled_get_leaves_no_wait_at_the_host,
    test_many_gets_wait_side_by_side,
)
from tests.support.operator import Operator, operating


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(tls=True, hosts=1, supernodes=1, durable=False) as made:
        yield made


@pytest.fixture(scope="module", autouse=True)
def operator(cluster: LocalCluster) -> Iterator[Operator]:
    files = cluster.tls_files("ops", Role.OPERATOR)
    assert files is not None
    with pytest.MonkeyPatch.context() as patch:
        for variable, path in (("CA", files.ca), ("CERTIFICATE", files.certificate), ("KEY", files.key)):
            patch.setenv(f"STAMPEDE_TLS_{variable}", str(path))
        with operating(cluster) as made:
            made.add("somebody", "*", "contract/*")  # the rights that the other tests need, and no more
            yield made


@pytest.fixture(params=["aio", "sync"])
async def scene(request: pytest.FixtureRequest, operator: Operator) -> AsyncIterator[Scene]:
    """Callers with certificates: clients, and operators, to which no rules apply."""

    def credentials_of(who: str) -> dict[str, Any]:
        role = Role.CLIENT if who else Role.OPERATOR
        return {"tls": operator.cluster.tls_files(who or "ops", role)}

    async with prepared(request.param, operator, credentials_of) as made:
        yield made


@pytest.fixture(params=["aio-grpc", "aio-socket", "sync-grpc", "sync-socket"])
async def surface(request: pytest.FixtureRequest, cluster: LocalCluster) -> AsyncIterator[Surface]:
    tls, (client, _, transport) = cluster.tls_files(), request.param.partition("-")
    if client == "aio":
        async with aio.connect(cluster.address, tls=tls, transport=transport) as connection:
            yield Surface(connection)
        return
    with st.connect(cluster.address, tls=tls, transport=transport) as blocking, ThreadPoolExecutor(16) as pool:
        yield Surface(blocking, pool)
