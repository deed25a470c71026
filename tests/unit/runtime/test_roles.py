"""The roles that may call each RPC, by certificate."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

import stampede_rt.v1
from stampede_rt_runtime.access.caller import Caller, CallerCertificate, by_certificate, by_secret
from stampede_rt_runtime.identity import Identity, Role, identity_among, parse_identity
from stampede_rt_runtime.roles import roles_for, why_refused

RAFT = "/stampede_rt.v1.RaftService/Exchange"
REMOVE = "/stampede_rt.v1.MembershipService/RemoveSupernode"

CLIENT = Identity("c", Role.CLIENT, "n")


def caller(role: Role, *, name: str = "n") -> Caller:
    return by_certificate(CallerCertificate(Identity("c", role, name)))


def rpcs_of_the_contract() -> list[str]:
    folder = Path(next(iter(stampede_rt.v1.__path__)))
    found = []
    for file in sorted(folder.glob("*_service_pb2.py")):
        described = import_module(f"stampede_rt.v1.{file.stem}").DESCRIPTOR
        for service in described.services_by_name.values():
            found += [f"/{service.full_name}/{method.name}" for method in service.methods]
    return found


@pytest.mark.parametrize("rpc", rpcs_of_the_contract())
def test_every_rpc_of_the_contract_has_allowed_roles(rpc: str) -> None:
    assert roles_for(rpc), f"{rpc} has no row in roles.py: decide who may call it"


def test_the_page_on_security_has_the_check_of_each_rpc_for_services() -> None:
    """Hosts, supernodes and front-ends have no rules of access, so each of these RPCs has a check of its own."""
    services = {Role.HOST, Role.SUPERNODE, Role.FRONTEND}
    page = (Path(__file__).parents[3] / "docs/security.md").read_text()
    page = page.partition("## The checks of statements by services")[2]
    rows = dict(re.findall(r"^\| `(\w+/\w+)` \| ([a-z, -]+) \|", page, re.MULTILINE))
    wanted = {}
    for rpc in rpcs_of_the_contract():
        roles = roles_for(rpc)
        if Role.CLIENT not in roles and roles & services:
            wanted[rpc.rpartition(".")[2]] = ", ".join(_SHOWN[role] for role in sorted(roles, key=_SHOWN.__getitem__))
    assert rows == wanted


_SHOWN = {
    Role.HOST: "hosts", Role.SUPERNODE: "supernodes", Role.FRONTEND: "front-ends", Role.OPERATOR: "operators"
}  # fmt: skip


def test_only_supernodes_may_send_raft_messages() -> None:
    assert roles_for(RAFT) == {Role.SUPERNODE}
    assert why_refused(RAFT, caller(Role.SUPERNODE)) == ""


@pytest.mark.parametrize("method", ["RegisterHost", "RenewHostLease", "DeregisterHost"])
def test_only_hosts_may_renew_leases_of_hosts(method: str) -> None:
    assert roles_for(f"/stampede_rt.v1.DirectoryService/{method}") == {Role.HOST}


def test_a_client_cannot_change_the_members_of_the_supernodes() -> None:
    for method in ("CreateJoinToken", "AddSupernode", "RemoveSupernode"):
        allowed = roles_for(f"/stampede_rt.v1.MembershipService/{method}")
        assert Role.CLIENT not in allowed
        assert Role.OPERATOR in allowed


@pytest.mark.parametrize("method", ["/no.Service/Method", "/stampede_rt.v1.NoService/Method", "nonsense", ""])
def test_a_method_without_a_row_is_for_no_role(method: str) -> None:
    assert roles_for(method) == frozenset()
    assert "nobody" in why_refused(method, caller(Role.OPERATOR))


def test_a_refusal_names_the_caller_the_call_and_the_role() -> None:
    reason = why_refused(RAFT, caller(Role.CLIENT, name="cam"))
    assert reason == (
        "client cam may not call RaftService/Exchange, which is for supernode; use a certificate of that role"
    )


@pytest.mark.parametrize("rpc", [RAFT, "/stampede_rt.v1.DirectoryService/RenewHostLease", REMOVE])
def test_a_holder_of_the_clients_secret_is_no_member(rpc: str) -> None:
    assert "a holder of the clients' secret may not call" in why_refused(rpc, by_secret(of_cluster=False))
    assert why_refused(rpc, by_secret(of_cluster=True)) == ""


@pytest.mark.parametrize("role", list(Role))
def test_an_identity_read_from_its_uri_is_the_same(role: Role) -> None:
    one = Identity("lab.1", role, "cam/left")
    assert parse_identity(one.uri) == one


@pytest.mark.parametrize(
    "uri",
    ["", "stampede://", "stampede://c/king/n", "stampede://c/client/", "https://c/client/n", "stampede://C/client/n"],
)
def test_a_malformed_uri_gives_no_identity(uri: str) -> None:
    with pytest.raises(ValueError):
        parse_identity(uri)
    assert identity_among([uri]) is None


def test_a_certificate_with_two_identities_gives_none() -> None:
    uris = [CLIENT.uri, Identity("c", Role.SUPERNODE, "n").uri]
    assert identity_among(uris) is None
    assert identity_among(["https://elsewhere", uris[0]]) == CLIENT
