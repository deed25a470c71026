"""The directory registers a host by a request of which the host does not know."""

from __future__ import annotations

from typing import Any

from stampede_rt.errors import LeaseExpired
from stampede_rt.status import abort
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory
from tests.unit.channel_host.cluster.test_registration import MS, Host, keeping


class StrictDirectory(FakeDirectory):
    """A directory that renews only its last registration of a host."""

    async def RenewHostLease(  # noqa: N802
        self, request: pb.RenewHostLeaseRequest, context: Any
    ) -> pb.RenewHostLeaseResponse:
        if request.registered_index != self.registered_index:
            await abort(context, LeaseExpired("the host was registered again; register it again"))
        return await super().RenewHostLease(request, context)


async def test_a_host_compares_its_channels_again_after_a_registration_of_which_it_does_not_know() -> None:
    fake = StrictDirectory(lease_ttl_nanos=200 * MS)
    async with serving(fake.register) as server:
        fake.target = server.address
        host = Host(fake.target)
        await host.registration.enter("localhost:1")
        await host.registered.get()
        async with keeping(host):
            await fake.called("RenewHostLease", times=2)
            fake.registered_index += 1
            answer = await host.registered.get()
            await fake.called("RenewHostLease", times=fake.calls["RenewHostLease"] + 2)
    assert answer.registered_index == fake.registered_index
