"""docs/wire.md lists the served RPCs.

Some service answers each of them, and all other RPCs are UNIMPLEMENTED everywhere.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module

import grpc
import pytest

from stampede_rt.security.credentials import call_metadata, read_secret
from stampede_rt.v1 import (
    directory_service_pb2,
    directory_service_pb2_grpc,
    frontend_service_pb2,
    frontend_service_pb2_grpc,
)
from stampede_rt_local.cluster import LocalCluster
from tests.polyglot.toolchains import PROTO, ROOT

CALL_SECONDS_MAX = 3.0
ROW = re.compile(r"^\| (`stampede_rt|`\w+Service`[^|]*) \|[^|]*\|[^|]*\| (yes|not yet)", re.MULTILINE)

Metadata = tuple[tuple[str, str], ...]


def services_marked(mark: str) -> list[str]:
    """The services of the page's table that are served ("yes") or not ("not yet")."""
    rows = ROW.findall((ROOT / "docs" / "wire.md").read_text())
    return sorted(name for names, shown in rows if shown == mark for name in re.findall(r"`(\w+)`", names))


def methods_of(service: str) -> list[str]:
    """The paths of a service's RPCs, from the generated descriptors."""
    for source in PROTO.rglob("*_service.proto"):
        module = import_module(f"stampede_rt.v1.{source.stem}_pb2")
        found = module.DESCRIPTOR.services_by_name.get(service)
        if found is not None:
            return [f"/{found.full_name}/{method.name}" for method in found.methods]
    raise LookupError(f"docs/wire.md names {service}, which no .proto has")


@pytest.fixture(scope="module")
def metadata(cluster: LocalCluster) -> Metadata:
    return call_metadata(read_secret(cluster.secret_file))


@pytest.fixture(scope="module")
def servers(cluster: LocalCluster, metadata: Metadata) -> Iterator[dict[str, grpc.Channel]]:
    """A connection to one server of each kind."""
    frontend = grpc.insecure_channel(cluster.address)
    bind = frontend_service_pb2_grpc.FrontendServiceStub(frontend).Bind
    bound = bind(frontend_service_pb2.BindRequest(protocol_version=1), metadata=metadata, timeout=CALL_SECONDS_MAX)
    supernode = grpc.insecure_channel(bound.supernodes[0].endpoint.target)
    list_hosts = directory_service_pb2_grpc.DirectoryServiceStub(supernode).ListHosts
    hosts = list_hosts(directory_service_pb2.ListHostsRequest(), metadata=metadata, timeout=CALL_SECONDS_MAX).hosts
    host = grpc.insecure_channel(hosts[0].gatekeepers[0].target)
    yield {"front-end": frontend, "supernode": supernode, "host": host}
    for channel in (frontend, supernode, host):
        channel.close()


def answer(channel: grpc.Channel, path: str, metadata: Metadata) -> grpc.StatusCode:
    """How one empty request is answered; OK at the first response. Works for RPCs of every kind."""
    call = channel.stream_stream(path)(iter([b""]), metadata=metadata, timeout=CALL_SECONDS_MAX)
    try:
        next(call, None)
    except grpc.RpcError:
        code: grpc.StatusCode = call.code()
        return code
    call.cancel()
    return grpc.StatusCode.OK


def test_every_service_of_the_contract_is_marked() -> None:
    in_contract = {
        name
        for source in PROTO.rglob("*.proto")
        for name in re.findall(r"^service (\w+)", source.read_text(), re.MULTILINE)
    }
    assert {*services_marked("yes"), *services_marked("not yet")} == in_contract


@pytest.mark.parametrize("service", services_marked("not yet"))
def test_a_service_that_is_not_served_yet_says_unimplemented(
    service: str, servers: dict[str, grpc.Channel], metadata: Metadata
) -> None:
    answers = {
        (kind, path): answer(channel, path, metadata)
        for kind, channel in servers.items()
        for path in methods_of(service)
    }
    assert set(answers.values()) == {grpc.StatusCode.UNIMPLEMENTED}, answers


@pytest.mark.parametrize("service", services_marked("yes"))
def test_every_rpc_of_a_served_service_is_served_somewhere(
    service: str, servers: dict[str, grpc.Channel], metadata: Metadata
) -> None:
    for path in methods_of(service):
        answers = {kind: answer(channel, path, metadata) for kind, channel in servers.items()}
        assert set(answers.values()) != {grpc.StatusCode.UNIMPLEMENTED}, path


@pytest.mark.parametrize("service", services_marked("not yet"))
def test_the_comment_of_a_service_that_is_not_served_yet_says_so(service: str) -> None:
    text = "".join(source.read_text() for source in sorted(PROTO.rglob("*_service.proto")))
    comment = text.partition(f"\nservice {service} ")[0].rpartition("\n\n")[2]
    assert "UNIMPLEMENTED" in comment
