"""The facts that hosts and peers may state when they register, and the callers that may ask for queues and peers."""

from __future__ import annotations

import secrets
from typing import Any

import pytest

from stampede_rt.errors import PermissionDenied, VersionMismatch
from stampede_rt.v1 import directory_pb2, peer_service_pb2, queue_directory_service_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.version import PROTOCOL_VERSION
from stampede_rt_runtime.identity import Identity, Role
from stampede_rt_runtime.roles import roles_for
from stampede_rt_supernode.core.callers import check_host_caller, check_protocol
from stampede_rt_supernode.servicers import calls
from tests.support.supernode.node import reason_of, running_node
from tests.support.supernode.operations import id_of

H1 = Identity("c", Role.HOST, "h1")


def registration(**fields: int | str) -> pb.RegisterHostRequest:
    return pb.RegisterHostRequest(
        request_id=secrets.token_bytes(16),
        host_id=id_of(1),
        name="host-1",
        gatekeepers=[directory_pb2.Endpoint(target="localhost:7001")],
        boot_incarnation=1,
        **fields,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(("registered_name", "new_name"), [(None, "h1"), ("h1", "h1"), ("h1", None), (None, None)])
def test_a_host_may_call_with_its_own_id(registered_name: str | None, new_name: str | None) -> None:
    check_host_caller(H1, registered_name=registered_name, new_name=new_name)


@pytest.mark.parametrize(("registered_name", "new_name"), [(None, "h2"), ("h2", "h1"), ("h2", None), ("h1", "h2")])
def test_a_host_may_not_call_with_the_id_of_another_host(registered_name: str | None, new_name: str | None) -> None:
    with pytest.raises(PermissionDenied, match="cannot speak for host h2"):
        check_host_caller(H1, registered_name=registered_name, new_name=new_name)


def test_without_certificates_a_caller_may_use_any_host_id() -> None:
    check_host_caller(None, registered_name="h2", new_name="h1")


def test_another_protocol_is_reported_with_both_versions() -> None:
    with pytest.raises(VersionMismatch, match=r"the host \(version 9\.9\) speaks protocol 7, this directory 1"):
        check_protocol(7, "9.9")
    check_protocol(0, "0.0.1")


async def test_a_host_of_another_release_may_register_but_not_one_of_another_protocol() -> None:
    async with running_node() as node:
        refused = await reason_of(node.stub.RegisterHost(registration(protocol_version=7, version="9.9"), timeout=5))
        assert refused.reason == "VERSION_MISMATCH"
        assert "install the same release on both" in refused.message
        answer = await node.stub.RegisterHost(registration(protocol_version=PROTOCOL_VERSION, version="9.9"), timeout=5)
        assert answer.protocol_version == PROTOCOL_VERSION
        assert answer.host.version == "9.9"


@pytest.mark.parametrize("service", [queue_directory_service_pb2, peer_service_pb2], ids=["queues", "peers"])
def test_clients_operators_and_hosts_may_call_the_services_of_queues_and_peers(service: Any) -> None:
    for described in service.DESCRIPTOR.services_by_name.values():
        for method in described.methods:
            allowed = roles_for(f"/{described.full_name}/{method.name}")
            assert allowed == {Role.CLIENT, Role.OPERATOR, Role.HOST}


@pytest.mark.parametrize(("caller", "refused"), [("host-1", False), ("host-2", True)])
async def test_only_a_host_itself_may_register_a_peer_with_its_host_id(
    monkeypatch: pytest.MonkeyPatch, caller: str, refused: bool
) -> None:
    async with running_node() as node:
        await node.register(1)
        monkeypatch.setattr(calls, "caller_identity", lambda context: Identity("c", Role.HOST, caller))
        entering = peer_service_pb2.RegisterPeerRequest(
            request_id=secrets.token_bytes(16), peer_id=id_of(7), boot_incarnation=1, host_id=id_of(1)
        )
        if refused:
            assert (await reason_of(node.peers.RegisterPeer(entering))).reason == "PERMISSION_DENIED"
        else:
            assert (await node.peers.RegisterPeer(entering)).peer.host_id == id_of(1)
