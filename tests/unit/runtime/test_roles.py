"""Who may call what, by certificate."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

import stampede_rt.v1
from stampede_rt_runtime.identity import Identity, Role, identity_among, parse_identity
from stampede_rt_runtime.roles import roles_for, why_refused

RAFT = "/stampede_rt.v1.RaftService/Exchange"


def identity(role: Role, *, cluster: str = "c", name: str = "n") -> Identity:
    return Identity(cluster, role, name)


def rpcs_of_the_contract() -> list[str]:
    folder = Path(next(iter(stampede_rt.v1.__path__)))
    found = []
    for file in sorted(folder.glob("*_service_pb2.py")):
        described = import_module(f"stampede_rt.v1.{file.stem}").DESCRIPTOR
        for service in described.services_by_name.values():
            found += [f"/{service.full_name}/{method.name}" for method in service.methods]
    return found


@pytest.mark.parametrize("rpc", rpcs_of_the_contract())
def test_every_rpc_of_the_contract_is_for_somebody(rpc: str) -> None:
    assert roles_for(rpc), f"{rpc} has no row in roles.py: decide who may call it"


def test_only_supernodes_speak_raft() -> None:
    assert roles_for(RAFT) == {Role.SUPERNODE}
    assert why_refused(RAFT, identity(Role.SUPERNODE), "c") == ""


@pytest.mark.parametrize("method", ["RegisterHost", "RenewHostLease", "DeregisterHost"])
def test_only_hosts_hold_leases(method: str) -> None:
    assert roles_for(f"/stampede_rt.v1.DirectoryService/{method}") == {Role.HOST}


def test_a_client_cannot_change_who_the_supernodes_are() -> None:
    for method in ("CreateJoinToken", "AddSupernode", "RemoveSupernode"):
        allowed = roles_for(f"/stampede_rt.v1.MembershipService/{method}")
        assert Role.CLIENT not in allowed
        assert Role.OPERATOR in allowed


@pytest.mark.parametrize("method", ["/no.Service/Method", "/stampede_rt.v1.NoService/Method", "nonsense", ""])
def test_what_has_no_row_is_for_nobody(method: str) -> None:
    assert roles_for(method) == frozenset()
    assert "nobody" in why_refused(method, identity(Role.OPERATOR), "c")


def test_a_refusal_names_the_caller_the_call_and_the_role() -> None:
    told = why_refused(RAFT, identity(Role.CLIENT, name="cam"), "c")
    assert told == (
        "client cam may not call RaftService/Exchange, which is for supernode; use a certificate of that role"
    )


def test_a_certificate_of_another_cluster_is_refused_whatever_its_role() -> None:
    told = why_refused("/grpc.health.v1.Health/Check", identity(Role.SUPERNODE, cluster="other"), "c")
    assert "cluster other" in told
    assert "this is c" in told


@pytest.mark.parametrize("role", list(Role))
def test_an_identity_survives_its_uri(role: Role) -> None:
    one = Identity("lab.1", role, "cam/left")
    assert parse_identity(one.uri) == one


@pytest.mark.parametrize(
    "uri",
    ["", "stampede://", "stampede://c/king/n", "stampede://c/client/", "https://c/client/n", "stampede://C/client/n"],
)
def test_a_broken_identity_is_none(uri: str) -> None:
    with pytest.raises(ValueError):
        parse_identity(uri)
    assert identity_among([uri]) is None


def test_two_identities_in_one_certificate_are_none() -> None:
    uris = [identity(Role.CLIENT).uri, identity(Role.SUPERNODE).uri]
    assert identity_among(uris) is None
    assert identity_among(["https://elsewhere", uris[0]]) == identity(Role.CLIENT)
