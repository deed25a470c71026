"""A host hears that its directory speaks another protocol."""

from __future__ import annotations

from typing import Any

import pytest

from stampede_rt.errors import VersionMismatch
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime.server import serving
from tests.unit.channel_host.fake_directory import FakeDirectory
from tests.unit.channel_host.test_registration import Host


class NewerDirectory(FakeDirectory):
    """Answers registrations in a later protocol."""

    async def RegisterHost(self, request: pb.RegisterHostRequest, context: Any) -> pb.RegisterHostResponse:  # noqa: N802
        assert request.protocol_version == 1
        response = await super().RegisterHost(request, context)
        response.protocol_version = 2
        return response


async def test_a_host_does_not_enter_a_directory_of_another_protocol() -> None:
    fake = NewerDirectory()
    async with serving(fake.register) as server:
        fake.target = server.address
        host = Host(server.address)
        with pytest.raises(VersionMismatch, match="the directory speaks protocol 2, this host 1"):
            await host.registration.enter("localhost:1", 5)
        assert not host.registration.lease_held()
        await host.supernodes.aclose()
