"""Quotas of later releases, while some supernodes run a release that cannot read a command about them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import pytest

from stampede_rt.errors import VersionMismatch
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_supernode.servicers.calls import DirectoryCalls
from stampede_rt_supernode.servicers.quota_servicer import LATER_QUOTAS, QuotaServicer
from tests.support.supernode.node import Node, running_node


class Call:
    """A call without a deadline."""

    def time_remaining(self) -> float | None:
        return None


@pytest.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        yield node


@pytest.mark.parametrize("quota", sorted(LATER_QUOTAS))
async def test_a_quota_that_a_member_cannot_read_is_not_written_to_the_log(node: Node, quota: Quota) -> None:
    servicer, call = QuotaServicer(DirectoryCalls(node.replica, node.submission)), Call()
    context: Any = call
    level = LATER_QUOTAS[quota]
    node.replica.read(lambda directory: setattr(directory, "feature_level", level - 1))
    with pytest.raises(VersionMismatch, match=f"the quota {quota} needs feature level {level}, the "):
        await servicer.check_known_to_all(context, [Quota.STREAMS, quota])
    await servicer.check_known_to_all(context, [Quota.STREAMS])
    node.replica.read(lambda directory: setattr(directory, "feature_level", level))
    await servicer.check_known_to_all(context, [quota])
