"""Every test of this folder runs with both clients."""

from __future__ import annotations

from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.contract.queues.rig import Rig


@pytest.fixture(params=["aio", "sync"])
async def rig(request: pytest.FixtureRequest, cluster: Any) -> AsyncIterator[Rig]:
    with ThreadPoolExecutor(16) as pool:
        made = Rig(cluster.address, pool if request.param == "sync" else None)
        made.rt = await made.connect()
        yield made
        for connection in made.connections:
            await connection.aclose()
