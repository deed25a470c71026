"""Connections that are cut while grpc.aio writes to them: gRPC reports some of these cuts as INTERNAL."""

from __future__ import annotations

import asyncio
import random
import time
from collections.abc import Iterator
from typing import Any

import grpc
import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.status import from_rpc_error
from tests.support.cutting_relay import CUTS
from tests.support.relayed_cluster import RelayedCluster, running_relayed_cluster

CUT_SECONDS_MAX = 120.0
SIZES = (10, 1000, 300_000, 2_000_000)  # requests of one piece, and of many


@pytest.fixture(scope="module")
def world() -> Iterator[RelayedCluster]:
    with running_relayed_cluster() as made:
        yield made


class GrpcErrors:
    """The errors of gRPC for failed calls, and the client's errors made from them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.internal: list[st.StampedeError] = []
        self.is_reported = asyncio.Event()
        for module in ("status", "transports.call_stream_async"):
            monkeypatch.setattr(f"stampede_rt.{module}.from_rpc_error", self._note)

    def _note(self, error: Any, target: str) -> st.StampedeError:
        made = from_rpc_error(error, target)
        if error.code() is grpc.StatusCode.INTERNAL:
            self.internal.append(made)
            self.is_reported.set()
        return made


async def test_a_broken_stream_that_grpc_reports_as_internal_is_retried(
    world: RelayedCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """gRPC reports about one of fifty cuts as INTERNAL. The test goes on until gRPC has reported such a cut."""
    errors = GrpcErrors(monkeypatch)
    failures: list[st.StampedeError] = []

    async def put(channel: aio.Channel, size: int) -> None:
        producer = channel.producer()
        while not errors.is_reported.is_set():
            try:
                await producer.put(bytes(size))
            except st.StampedeError as error:
                failures.append(error)
        await producer.flush(30)
        await producer.aclose()

    async with aio.connect(world.address, transport="grpc") as rt:
        channel = await rt.channel("cut/puts", max_age="5s")
        cutting = asyncio.ensure_future(_cut(world, errors))
        await asyncio.gather(*(put(channel, size) for size in SIZES))
        await cutting
        assert (await channel.put(b"goes on")).payload == b"goes on"
    if not errors.internal:
        pytest.skip(f"gRPC reported no cut as INTERNAL within {CUT_SECONDS_MAX:g} s, as happens on a very busy machine")
    assert all(isinstance(error, st.Unavailable) and error.retryable for error in errors.internal)
    assert all(error.retryable or isinstance(error, st.DeadlineExceeded) for error in failures)


async def _cut(world: RelayedCluster, errors: GrpcErrors) -> None:
    random_source, until_s = random.Random(1), time.monotonic() + CUT_SECONDS_MAX
    while not errors.is_reported.is_set() and time.monotonic() < until_s:
        world.relay.cut(random_source.choice(CUTS))
        await asyncio.wait([asyncio.ensure_future(errors.is_reported.wait())], timeout=random_source.random() * 0.1)
    errors.is_reported.set()
