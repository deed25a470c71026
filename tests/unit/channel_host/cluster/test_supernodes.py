"""The calls of a host to the directory: temporary and permanent errors, and connections that close."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import ChannelNotFound, Unavailable
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory


@pytest.mark.parametrize(("final_reason", "calls"), [("NO_HOST", 1), (None, 2)])
async def test_a_call_repeats_after_an_error_unless_the_error_has_the_final_reason(
    final_reason: str | None, calls: int
) -> None:
    directory = FakeDirectory()
    directory.refuse["ResolveChannel"] = Unavailable("every live host holds it", reason="NO_HOST")
    async with serving(directory.register) as supernode:
        directory.target = supernode.address
        supernodes = Supernodes((supernode.address,), lambda target: dial(target, secret=None), peer_name="h1")
        try:
            with pytest.raises(Unavailable):
                await supernodes.call(
                    "ResolveChannel", pb.ResolveChannelRequest(), 10.0 if final_reason else 0.5,
                    final_reason=final_reason,
                )  # fmt: skip
        finally:
            await supernodes.aclose()
    assert min(directory.calls["ResolveChannel"], 2) == calls


class SilentSupernode(FakeDirectory):
    """A supernode that takes requests, and never answers one."""

    async def ResolveChannel(self, request: Any, context: Any) -> Any:  # noqa: N802
        await self._begin("ResolveChannel", context)
        await asyncio.Event().wait()


async def test_a_call_asks_another_supernode_if_the_cluster_removes_the_stopped_one_meanwhile() -> None:
    stopped, directory = SilentSupernode(), FakeDirectory()
    directory.refuse["ResolveChannel"] = ChannelNotFound("no such channel")
    async with serving(stopped.register) as gone, serving(directory.register) as stays:
        directory.target = gone.address
        supernodes = Supernodes((stays.address,), lambda target: dial(target, secret=None), peer_name="h1")
        try:
            asking = asyncio.create_task(supernodes.call("ResolveChannel", pb.ResolveChannelRequest(), 10.0))
            await stopped.called("ResolveChannel", times=1)
            directory.target = stays.address
            await supernodes.bind(asyncio.get_running_loop().time() + 3.0)
            with pytest.raises(ChannelNotFound):
                await asking
        finally:
            await supernodes.aclose()


async def test_a_broken_stream_does_not_change_the_order_of_calls_and_the_next_one_goes_to_another_supernode() -> None:
    """In an earlier version, each call first asked the supernode whose stream had broken."""
    leader, follower = FakeDirectory(), FakeDirectory()
    leader.refuse["Watch"] = follower.refuse["Watch"] = Unavailable("the supernode stops", reason="SHUTTING_DOWN")
    async with serving(leader.register) as first, serving(follower.register) as second:
        leader.target, leader.others = second.address, [first.address]
        supernodes = Supernodes((first.address,), lambda target: dial(target, secret=None), peer_name="h1")
        try:
            for _ in range(2):
                with pytest.raises(Unavailable):
                    await anext(supernodes.stream("Watch", pb.WatchRequest()))
                assert supernodes.known() == (first.address, second.address)
        finally:
            await supernodes.aclose()
    assert (leader.calls["Watch"], follower.calls["Watch"]) == (1, 1)
