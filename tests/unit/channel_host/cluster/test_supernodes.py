"""A call of the directory ends at once with an error for which its caller does not want to wait."""

from __future__ import annotations

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.supernodes import Supernodes
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory


@pytest.mark.parametrize(("final_reason", "asked"), [("NO_HOST", 1), (None, 2)])
async def test_a_call_waits_until_an_error_passes_unless_the_caller_names_its_reason(
    final_reason: str | None, asked: int
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
    assert min(directory.calls["ResolveChannel"], 2) == asked
