"""After cuts and cancellations no call hangs, no acknowledged item is lost or repeated, and no task or thread is left.

`make fuzz` runs other and longer scenarios: STAMPEDE_FUZZ_SCENARIOS of STAMPEDE_FUZZ_SECONDS each, from
STAMPEDE_FUZZ_SEED on.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator

import pytest

from tests.robustness.fuzz.scenario import Scenario
from tests.support.relayed_cluster import RelayedCluster, running_relayed_cluster

SECONDS = float(os.environ.get("STAMPEDE_FUZZ_SECONDS", "1"))
SCENARIOS = int(os.environ.get("STAMPEDE_FUZZ_SCENARIOS", "2"))
FIRST_SEED = int(os.environ.get("STAMPEDE_FUZZ_SEED", "1"))


@pytest.fixture(scope="module")
def world() -> Iterator[RelayedCluster]:
    with running_relayed_cluster() as made:
        yield made


@pytest.mark.parametrize("seed", range(FIRST_SEED, FIRST_SEED + SCENARIOS))
@pytest.mark.parametrize("client", ["aio", "sync"])
def test_calls_over_a_network_that_breaks_end_and_lose_nothing(
    client: str, seed: int, world: RelayedCluster, caplog: pytest.LogCaptureFixture
) -> None:
    async def play() -> str:
        return await Scenario(world, client, seed, SECONDS).play()

    print(asyncio.run(play()))
    unseen = [record.getMessage() for record in caplog.records if "never retrieved" in record.getMessage()]
    assert not unseen
