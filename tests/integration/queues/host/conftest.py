"""A host for each test of this folder, with a directory of queues."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from tests.support.channel_host.queue_rig import (
    QueueRig,
    running_queue_host,
)


@pytest.fixture
async def rig() -> AsyncIterator[QueueRig]:
    async with running_queue_host() as rig:
        yield rig
