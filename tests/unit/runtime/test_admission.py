"""A server with certificates, and the callers that its port and its handlers admit."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt.errors import PermissionDenied
from stampede_rt.security.tls import TlsFiles, TlsReader
from stampede_rt.security.tls_diagnosis import explain_refusal
from stampede_rt.status import from_rpc_error
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime import admission
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.dial import Dialer, dial
from stampede_rt_runtime.health_check import main as health_check
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.listen import AddressNotAllowed
from stampede_rt_runtime.server import serving
from stampede_rt_runtime.tls import ServiceTls, load_tls

DAY = timedelta(days=1)
HOSTS_ONLY = "/stampede_rt.v1.DirectoryService/RegisterHost"
RIGHT = Secret(text="right", path=Path("/nowhere"))
WRONG = Secret(text="wrong", path=Path("/nowhere"))


@pytest.fixture(autouse=True)
def without_rules(monkeypatch: pytest.MonkeyPatch) -> None:
    """The services of these tests never learn of rules, so no call waits for them."""
    monkeypatch.setattr(admission, "STATE_SECONDS_MAX", 0.0)


@pytest.fixture
def made(tmp_path: Path) -> ClusterCertificates:
    return ClusterCertificates(tmp_path / "certs")


@pytest.fixture
def own(made: ClusterCertificates) -> ServiceTls:
    return load_tls(made.issue(Role.SUPERNODE, "s1"), Role.SUPERNODE)


class Handlers(grpc.GenericRpcHandler):
    """Answers each call of HOSTS_ONLY with its request, in the style that `kind` names."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.called = 0

    def service(self, handler_call_details: grpc.HandlerCallDetails) -> Any:
        if handler_call_details.method != HOSTS_ONLY:
            return None
        makers: dict[str, Callable[[], Any]] = {
            "unary_unary": lambda: grpc.unary_unary_rpc_method_handler(self.one),
            "unary_stream": lambda: grpc.unary_stream_rpc_method_handler(self.many),
            "stream_unary": lambda: grpc.stream_unary_rpc_method_handler(self.one_of_many),
            "stream_stream": lambda: grpc.stream_stream_rpc_method_handler(self.reading),
        }
        return makers[self.kind]()

    async def one(self, request: bytes, context: Any) -> bytes:
        self.called += 1
        return request

    async def many(self, request: bytes, context: Any) -> AsyncIterator[bytes]:
        self.called += 1
        yield request

    async def one_of_many(self, requests: AsyncIterator[bytes], context: Any) -> bytes:
        self.called += 1
        return await anext(requests)

    async def reading(self, _requests: Any, context: Any) -> None:
        self.called += 1
        await context.write(await context.read())


async def one_request() -> AsyncIterator[bytes]:
    yield b"x"


async def no_request() -> AsyncIterator[bytes]:
    """No request, for a call that the server refuses: a write after the end of the call would hide the reason."""
    await asyncio.Event().wait()
    yield b""


async def answer(
    channel: grpc.aio.Channel, kind: str, requests: Callable[[], AsyncIterator[bytes]] = one_request
) -> bytes:
    call: Any = getattr(channel, kind)(HOSTS_ONLY)
    streams_in, streams_out = kind.startswith("stream"), kind.endswith("stream")
    running = call(requests(), timeout=5) if streams_in else call(b"x", timeout=5)
    return await first(running) if streams_out else bytes(await running)


async def first(running: Any) -> bytes:
    async for one in running:
        return bytes(one)
    await running.code()
    raise AssertionError("the stream ended without an answer")


@pytest.mark.parametrize("kind", ["unary_unary", "unary_stream", "stream_unary", "stream_stream"])
async def test_every_kind_of_call_is_allowed_only_to_its_roles(
    kind: str, made: ClusterCertificates, own: ServiceTls
) -> None:
    handlers = Handlers(kind)
    async with serving(lambda server: server.add_generic_rpc_handlers((handlers,)), tls=own) as server:
        host = TlsReader(made.issue(Role.HOST, "h1"))
        async with dial(server.address, secret=None, tls=host) as channel:
            assert await answer(channel, kind) == b"x"
        client = TlsReader(made.issue(Role.CLIENT, "cam"))
        async with dial(server.address, secret=None, tls=client) as channel:
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await answer(channel, kind, no_request)
    error = from_rpc_error(caught.value, "it")
    assert isinstance(error, PermissionDenied)
    assert str(error) == (
        "client cam may not call DirectoryService/RegisterHost, which is for host; use a certificate of that role"
    )
    assert handlers.called == 1


async def test_a_port_refuses_a_certificate_of_another_cluster_even_if_it_trusts_its_authority(
    made: ClusterCertificates, tmp_path: Path
) -> None:
    other = ClusterCertificates(tmp_path / "other", cluster="other")
    both = tmp_path / "both.pem"
    both.write_bytes(made.ca.read_bytes() + other.ca.read_bytes())
    trusting = made.issue(Role.SUPERNODE, "s1")
    tls = load_tls(TlsFiles(ca=both, certificate=trusting.certificate, key=trusting.key), Role.SUPERNODE)
    stranger = other.issue(Role.HOST, "h1")
    async with serving(lambda _: None, tls=tls) as server:
        reader = TlsReader(TlsFiles(ca=made.ca, certificate=stranger.certificate, key=stranger.key))
        async with dial(server.address, secret=None, tls=reader) as channel:
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await health_pb2_grpc.HealthStub(channel).Check(health_pb2.HealthCheckRequest(), timeout=5)
    assert "is one of cluster other, but this service is of cluster local" in (caught.value.details() or "")


@pytest.mark.parametrize(("secret", "what"), [(None, "brought no secret"), (WRONG, "a secret that differs")])
async def test_a_port_with_a_secret_and_certificates_requires_both(
    secret: Secret | None, what: str, made: ClusterCertificates, own: ServiceTls
) -> None:
    client = TlsReader(made.issue(Role.CLIENT, "cam"))
    ask = health_pb2.HealthCheckRequest()
    async with serving(lambda _: None, secret=RIGHT, tls=own) as server:
        async with dial(server.address, secret=RIGHT, tls=client) as channel:
            assert await health_pb2_grpc.HealthStub(channel).Watch(ask, timeout=5).read()
        async with dial(server.address, secret=secret, tls=client) as channel:
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await health_pb2_grpc.HealthStub(channel).Watch(ask, timeout=5).read()
    error = from_rpc_error(caught.value, "it")
    assert isinstance(error, PermissionDenied)
    assert what in str(error)


async def test_new_connections_get_the_new_certificate_and_open_ones_continue(
    made: ClusterCertificates, own: ServiceTls, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt.security.tls.LOOK_EVERY_S", 0.0)
    ask = health_pb2.HealthCheckRequest()
    async with serving(lambda _: None, tls=own) as server:
        credentials = Dialer(secret=None, tls=load_tls(made.issue(Role.HOST, "h1"), Role.HOST))
        channel = credentials(server.address)
        stub = health_pb2_grpc.HealthStub(channel)
        watch = stub.Watch(ask, timeout=20)
        assert (await watch.read()).status == health_pb2.HealthCheckResponse.SERVING
        made.add_authority()
        assert (await stub.Check(ask, timeout=5)).status == health_pb2.HealthCheckResponse.SERVING
        made.renew()
        made.forget_former()
        assert (await stub.Check(ask, timeout=5)).status == health_pb2.HealthCheckResponse.SERVING
        newcomer = TlsReader(made.issue(Role.HOST, "h2"))  # trusts only the new authority
        async with dial(server.address, secret=None, tls=newcomer) as connection:
            answer = await health_pb2_grpc.HealthStub(connection).Check(ask, timeout=5)
        assert answer.status == health_pb2.HealthCheckResponse.SERVING
        await server.set_serving(False)
        assert (await watch.read()).status == health_pb2.HealthCheckResponse.NOT_SERVING
        watch.cancel()
        await channel.close()


async def test_a_channel_that_has_lost_its_connection_reconnects_with_the_new_certificate(
    made: ClusterCertificates, own: ServiceTls, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stampede_rt.security.tls.LOOK_EVERY_S", 0.0)
    ask = health_pb2.HealthCheckRequest()
    caller = TlsReader(made.issue(Role.HOST, "h1"))
    async with serving(lambda _: None, tls=own) as server:
        channel = dial(server.address, secret=None, tls=caller)
        stub = health_pb2_grpc.HealthStub(channel)
        assert (await stub.Check(ask, timeout=5)).status == health_pb2.HealthCheckResponse.SERVING
    made.add_authority()
    made.renew()
    made.forget_former()
    async with serving(lambda _: None, listen=server.address, tls=own):
        answer = await stub.Check(ask, timeout=5, wait_for_ready=True)
    assert answer.status == health_pb2.HealthCheckResponse.SERVING
    await channel.close()


async def test_the_health_check_uses_the_certificate_of_the_service_beside_it(
    made: ClusterCertificates, own: ServiceTls, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    async with serving(lambda _: None, tls=own) as server:
        assert await asyncio.to_thread(health_check, [server.address]) == 1
        for variable, path in zip(("CA", "CERTIFICATE", "KEY"), own.reader.files.paths(), strict=True):
            monkeypatch.setenv(f"STAMPEDE_FRONTEND_TLS_{variable}", str(path))
        capsys.readouterr()
        assert await asyncio.to_thread(health_check, [server.address]) == 0
    assert "SERVING" in capsys.readouterr().out


async def refusal(target: str, files: TlsFiles | None) -> str:
    async with asyncio.timeout(45):
        found = await asyncio.to_thread(explain_refusal, target, TlsReader(files) if files else None)
    assert found is not None
    assert "\n" not in found.message
    return found.message


async def test_the_error_of_a_client_names_the_fault_of_the_services_certificate(
    made: ClusterCertificates, tmp_path: Path
) -> None:
    client = made.issue(Role.CLIENT, "cam")
    late = made.issue(Role.HOST, "late", begins=datetime.now(UTC) - 2 * DAY, lifetime=DAY)
    early = made.issue(Role.HOST, "early", begins=datetime.now(UTC) + DAY, lifetime=DAY)
    elsewhere = ClusterCertificates(tmp_path / "elsewhere")
    elsewhere._addresses = ("rig.example",)
    away = elsewhere.issue(Role.HOST, "away")
    both = TlsFiles(ca=elsewhere.ca, certificate=client.certificate, key=client.key)
    caller_cannot_serve = made.issue(Role.CLIENT, "impostor")
    for files, asks, expected in (
        (late, client, "has expired; issue it anew"),
        (early, client, "is not valid yet; look at the clocks"),
        (away, client, "is of an authority that"),
        (away, both, "is for other addresses"),
        (caller_cannot_serve, client, "is not for a service"),
    ):
        good = load_tls(made.issue(Role.HOST, "h1"), Role.HOST)
        tls = ServiceTls(TlsReader(files), good.identity, good.addresses)
        async with serving(lambda _: None, tls=tls) as server:
            assert expected in await refusal(server.address, asks)


async def test_the_error_of_a_client_says_that_the_service_uses_plain_text(made: ClusterCertificates) -> None:
    async with serving(lambda _: None) as server:
        error = await refusal(server.address, made.issue(Role.CLIENT, "cam"))
        assert error == (
            f"{server.address} speaks plain text, not TLS; "
            "leave the certificates out, or give that service certificates"
        )
        assert await asyncio.to_thread(explain_refusal, server.address, None) is None


async def test_no_error_names_certificates_if_they_are_valid_or_no_service_answers(
    made: ClusterCertificates, own: ServiceTls
) -> None:
    reader = TlsReader(made.issue(Role.CLIENT, "cam"))
    async with serving(lambda _: None, tls=own) as server:
        assert await asyncio.to_thread(explain_refusal, server.address, reader) is None
    assert await asyncio.to_thread(explain_refusal, server.address, reader) is None
    assert explain_refusal("unix:/nowhere", reader) is None


async def test_with_certificates_a_service_may_listen_everywhere(own: ServiceTls) -> None:
    async with serving(lambda _: None, listen="0.0.0.0:0", tls=own) as server:
        assert server.address.startswith("0.0.0.0:")
    with pytest.raises(AddressNotAllowed):
        async with serving(lambda _: None, listen="0.0.0.0:0"):
            pass
