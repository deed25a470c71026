"""The files of secrets."""

from __future__ import annotations

import asyncio
import stat
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import grpc
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt.errors import PermissionDenied
from stampede_rt.security.credentials import read_secret
from stampede_rt.status import from_rpc_error
from stampede_rt_runtime import admission
from stampede_rt_runtime.auth import Secret, load_client_secret, load_secret, make_secret_file
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.server import serving

RIGHT = Secret(text="right", path=Path("secret"))
WRONG = Secret(text="wrong", path=Path("secret"))
ASK = health_pb2.HealthCheckRequest()
LIMIT_S = 20.0


@pytest.fixture(autouse=True)
def _no_secret_of_the_user(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("STAMPEDE_SECRET_FILE", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def test_a_new_secret_is_long_and_only_its_owner_can_read_it(tmp_path: Path) -> None:
    made = make_secret_file(tmp_path / "new" / "secret")
    assert len(made.text) >= 40
    assert stat.S_IMODE(made.path.stat().st_mode) == 0o600
    assert stat.S_IMODE(made.path.parent.stat().st_mode) == 0o700
    assert [one.name for one in made.path.parent.iterdir()] == ["secret"]


def test_an_existing_secret_is_kept(tmp_path: Path) -> None:
    assert make_secret_file(tmp_path / "secret") == make_secret_file(tmp_path / "secret")


def test_processes_that_make_the_secret_at_the_same_time_all_get_the_same_one(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda _: make_secret_file(tmp_path / "secret").text, range(32)))
    assert len(set(made)) == 1


def test_a_secret_that_others_can_read_is_refused(tmp_path: Path) -> None:
    make_secret_file(tmp_path / "secret").path.chmod(0o604)
    with pytest.raises(PermissionDenied, match="chmod 600"):
        make_secret_file(tmp_path / "secret")


def test_an_empty_secret_is_refused(tmp_path: Path) -> None:
    (tmp_path / "secret").touch(mode=0o600)
    with pytest.raises(PermissionDenied, match="is empty"):
        load_secret(tmp_path / "secret")


def test_a_named_secret_file_must_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(PermissionDenied, match="there is no secret file"):
        load_secret(tmp_path / "secret")
    monkeypatch.setenv("STAMPEDE_SECRET_FILE", str(tmp_path / "secret"))
    with pytest.raises(PermissionDenied, match="there is no secret file"):
        load_secret(None)


def test_the_users_own_secret_may_be_absent(tmp_path: Path) -> None:
    assert load_secret(None) is None
    made = make_secret_file()
    assert made.path == tmp_path / "config" / "stampede" / "secret"
    assert load_secret(None) == made


def test_the_printed_form_of_a_secret_does_not_contain_it() -> None:
    assert "right" not in repr(RIGHT)


def test_during_a_replacement_a_file_holds_the_old_and_the_new_secret(tmp_path: Path) -> None:
    place = make_secret_file(tmp_path / "secret").path
    place.write_text("new\n\nold\n")
    assert load_secret(place) == Secret(text="new", path=place, other="old")
    assert read_secret(place) == "new"
    place.write_text("a\nb\nc\n")
    with pytest.raises(PermissionDenied, match="has 3 lines"):
        load_secret(place)


def test_the_clients_secret_needs_one_of_the_cluster_and_differs_from_it(tmp_path: Path) -> None:
    clients, cluster = make_secret_file(tmp_path / "clients"), make_secret_file(tmp_path / "cluster")
    assert load_client_secret(None, cluster) is None
    assert load_client_secret(clients.path, cluster) == clients
    with pytest.raises(PermissionDenied, match="the cluster has none for its services"):
        load_client_secret(clients.path, None)
    shared = Secret(text="x", path=cluster.path, other=clients.text)
    with pytest.raises(PermissionDenied, match="hold the same value"):
        load_client_secret(clients.path, shared)


async def test_both_values_of_a_secret_open_the_port_while_it_is_replaced() -> None:
    both = Secret(text="right", path=Path("secret"), other="former")
    async with serving(register, secret=both) as server:
        for secret in (RIGHT, Secret(text="former", path=Path("secret"))):
            assert (await first_of_watch(server.address, secret)).status == health_pb2.HealthCheckResponse.SERVING
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await first_of_watch(server.address, WRONG)
    assert caught.value.code() is grpc.StatusCode.UNAUTHENTICATED


async def test_a_caller_with_the_secret_of_clients_may_call_only_the_methods_for_clients(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(admission, "STATE_SECONDS_MAX", 0.0)  # the service never learns of rules
    clients = Secret(text="for clients", path=Path("clients"))
    async with serving(register, secret=RIGHT, client_secret=clients) as server:
        assert (await first_of_watch(server.address, clients)).status == health_pb2.HealthCheckResponse.SERVING
        async with dial(server.address, secret=clients) as channel:
            with pytest.raises(grpc.aio.AioRpcError) as caught:
                await channel.unary_unary("/stampede_rt.v1.MembershipService/RemoveSupernode")(b"", timeout=LIMIT_S)
    assert caught.value.code() is grpc.StatusCode.PERMISSION_DENIED


def register(server: grpc.aio.Server) -> None:
    """The health service is there anyway; its Watch stands for all methods that need the secret."""

    async def never(request: bytes, context: Any) -> bytes:
        raise AssertionError("the test must not call this method")

    handlers = {"RemoveSupernode": grpc.unary_unary_rpc_method_handler(never)}
    server.add_generic_rpc_handlers(
        (grpc.method_handlers_generic_handler("stampede_rt.v1.MembershipService", handlers),)
    )


async def first_of_watch(address: str, secret: Secret | None) -> health_pb2.HealthCheckResponse:
    async with dial(address, secret=secret) as channel:
        return await health_pb2_grpc.HealthStub(channel).Watch(ASK, timeout=LIMIT_S).read()


async def test_a_call_with_the_secret_is_accepted() -> None:
    async with serving(register, secret=RIGHT) as server:
        answer = await first_of_watch(server.address, RIGHT)
    assert answer.status == health_pb2.HealthCheckResponse.SERVING


@pytest.mark.parametrize(("secret", "what"), [(None, "brought no secret"), (WRONG, "a secret that differs")])
async def test_a_call_without_the_right_secret_is_refused_with_the_places_of_secrets(
    secret: Secret | None, what: str
) -> None:
    async with serving(register, secret=RIGHT) as server:
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await first_of_watch(server.address, secret)
        error = from_rpc_error(caught.value, server.address)
    assert caught.value.code() is grpc.StatusCode.UNAUTHENTICATED
    assert isinstance(error, PermissionDenied)
    assert error.reason == "UNAUTHENTICATED"
    assert what in str(error)
    assert "$STAMPEDE_SECRET_FILE" in str(error)
    assert "right" not in str(error)


@pytest.mark.parametrize("value", ["right", "bearer right", "Bearer right ", "Bearer ", "Bearer righ"])
async def test_only_the_exact_form_of_the_authorization_is_admitted(value: str) -> None:
    async with serving(register, secret=RIGHT) as server, dial(server.address, secret=None) as channel:
        call = health_pb2_grpc.HealthStub(channel).Watch(ASK, timeout=LIMIT_S, metadata=(("authorization", value),))
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await call.read()
    assert caught.value.code() is grpc.StatusCode.UNAUTHENTICATED


async def test_a_method_that_does_not_exist_is_refused_in_the_same_way() -> None:
    async with serving(register, secret=RIGHT) as server, dial(server.address, secret=None) as channel:
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await channel.unary_unary("/no.Service/Method")(b"", timeout=LIMIT_S)
    assert caught.value.code() is grpc.StatusCode.UNAUTHENTICATED


async def test_the_health_check_needs_no_secret() -> None:
    async with serving(register, secret=RIGHT) as server, dial(server.address, secret=None) as channel:
        answer = await health_pb2_grpc.HealthStub(channel).Check(ASK, timeout=LIMIT_S)
    assert answer.status == health_pb2.HealthCheckResponse.SERVING


async def test_the_secret_is_added_to_the_metadata_of_a_call() -> None:
    async with serving(register, secret=RIGHT) as server, dial(server.address, secret=RIGHT) as channel:
        call = health_pb2_grpc.HealthStub(channel).Watch(ASK, timeout=LIMIT_S, metadata=(("x-other", "1"),))
        assert (await call.read()).status == health_pb2.HealthCheckResponse.SERVING


def register_kinds(server: grpc.aio.Server) -> None:
    """A method of each kind of call. It takes all its requests: gRPC itself may fail a call that ends before that."""

    async def answer(request: Any, context: Any) -> bytes:
        return b"".join([one async for one in request]) if hasattr(request, "__aiter__") else request

    async def answers(request: Any, context: Any) -> AsyncIterator[bytes]:
        yield await answer(request, context)

    handlers = {
        "unary_unary": grpc.unary_unary_rpc_method_handler(answer),
        "unary_stream": grpc.unary_stream_rpc_method_handler(answers),
        "stream_unary": grpc.stream_unary_rpc_method_handler(answer),
        "stream_stream": grpc.stream_stream_rpc_method_handler(answers),
    }
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler("test.Kinds", handlers),))


@pytest.mark.parametrize("kind", ["unary_unary", "unary_stream", "stream_unary", "stream_stream"])
async def test_a_client_sends_the_secret_with_all_kinds_of_calls(kind: str) -> None:
    """A gRPC channel has a separate method to make each kind of call."""
    async with serving(register_kinds, secret=RIGHT) as server, dial(server.address, secret=RIGHT) as channel:
        call = getattr(channel, kind)(f"/test.Kinds/{kind}")
        started = call(iter([b"request"]) if kind.startswith("stream") else b"request")
        async with asyncio.timeout(LIMIT_S):
            assert await (started.read() if kind.endswith("stream") else started) == b"request"
            assert await started.code() is grpc.StatusCode.OK
