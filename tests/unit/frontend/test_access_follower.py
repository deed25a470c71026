"""A front-end gets token keys and revocations: it asks for them when the answer to a probe has a later version."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc

from stampede_rt.v1 import access_service_pb2, access_service_pb2_grpc
from stampede_rt_frontend.access_follower import AccessFollower
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving


class SupernodeAnswers(access_service_pb2_grpc.AccessServiceServicer):
    """A supernode's answers. `version` 0: the supernode refuses to answer."""

    def __init__(self) -> None:
        self.version, self.calls = 7, 0

    async def GetAccessState(self, request: Any, context: Any) -> access_service_pb2.GetAccessStateResponse:  # noqa: N802
        self.calls += 1
        if not self.version:
            await context.abort(grpc.StatusCode.UNAVAILABLE, "not now")
        return access_service_pb2.GetAccessStateResponse(version=self.version, cluster_id="c", revoked_serials=["a1"])


@asynccontextmanager
async def followed() -> AsyncIterator[tuple[SupernodeAnswers, AccessControl, AccessFollower, grpc.aio.Channel]]:
    supernode, control = SupernodeAnswers(), AccessControl()
    register = access_service_pb2_grpc.add_AccessServiceServicer_to_server
    async with (
        serving(lambda server: register(supernode, server)) as server,
        dial(server.address, secret=None) as channel,
    ):
        yield supernode, control, AccessFollower(control), channel


async def test_a_front_end_asks_for_a_later_version_once_and_for_an_earlier_one_never() -> None:
    async with followed() as (supernode, control, follower, channel):
        for version in (7, 7, 6, 0):
            await follower.take_version("c", version, channel)
        assert (supernode.calls, control.version) == (1, 7)
        supernode.version = 9
        await follower.take_version("c", 8, channel)
        state = control.refresh()
        assert state is not None
        assert (supernode.calls, state.version, state.revoked_serials) == (2, 9, frozenset({"a1"}))


async def test_a_cluster_that_takes_the_place_of_another_has_versions_of_its_own() -> None:
    async with followed() as (supernode, control, follower, channel):
        await follower.take_version("former", 0, channel)
        assert (supernode.calls, control.version) == (0, 0)
        await follower.take_version("c", 7, channel)
        assert (supernode.calls, control.version) == (1, 7)


async def test_a_front_end_asks_again_if_a_supernode_does_not_answer() -> None:
    async with followed() as (supernode, control, follower, channel):
        supernode.version = 0
        await follower.take_version("c", 7, channel)
        assert control.refresh() is None
        supernode.version = 7
        await follower.take_version("c", 7, channel)
        assert (supernode.calls, control.version) == (2, 7)
