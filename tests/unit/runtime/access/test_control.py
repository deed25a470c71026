"""The calls under way at one port end when they lose the credential or the right that they need."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc
import pytest

from stampede_rt.errors import PermissionDenied, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt_runtime import admission
from stampede_rt_runtime.access import control
from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.access.control import (
    CALLS_ENDED_PER_TURN,
    CALLS_LOOKED_AT_PER_TURN,
    CALLS_PER_TURN,
    RIGHTS_PER_TURN,
    AccessControl,
    allowed_to,
    check_access,
    check_known,
    own_name,
    request_rights,
)
from stampede_rt_runtime.access.open_call import REQUESTS_PER_STEP
from stampede_rt_runtime.access.rules import AccessKind, AccessRule, AccessRules, AccessVerb
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.access.tokens import TokenClaims, make_token, public_key
from stampede_rt_runtime.auth import Secret
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.server import ServiceServer, serving

CLUSTER, CLIENTS = Secret(text="cluster", path=Path("a")), Secret(text="clients", path=Path("b"))
READ = "/stampede_rt.v1.ChannelService/Subscribe"
ALLOW = AccessRule("@clients", (AccessVerb.READ,), None, "open")


class Streams(grpc.GenericRpcHandler):
    """One stream for each caller.

    Each request names a channel to read, and each answer says whether the caller may list it.
    """

    def service(self, details: grpc.HandlerCallDetails) -> Any:
        return grpc.stream_stream_rpc_method_handler(self.read) if details.method == READ else None

    async def read(self, _requests: Any, context: Any) -> None:
        async with asyncio.TaskGroup() as tasks:  # as the host's streams do
            await tasks.create_task(self._read(context))

    async def _read(self, context: Any) -> None:
        while (name := await context.read()) is not grpc.aio.EOF:
            check_known(AccessKind.CHANNEL, name.decode())
            check_access(AccessVerb.READ, AccessKind.CHANNEL, name.decode())
            await context.write(b"%d" % allowed_to(AccessVerb.LIST, AccessKind.CHANNEL)(name.decode()))


@asynccontextmanager
async def port() -> AsyncIterator[tuple[ServiceServer, Callable[[Secret], Any]]]:
    async with (
        serving(
            lambda server: server.add_generic_rpc_handlers((Streams(),)), secret=CLUSTER, client_secret=CLIENTS
        ) as server,
        dial(server.address, secret=CLUSTER) as members,
        dial(server.address, secret=CLIENTS) as clients,
    ):
        yield server, lambda secret: (members if secret is CLUSTER else clients).stream_stream(READ)(timeout=20)


async def answer_to(call: Any, name: str) -> bytes:
    await call.write(name.encode())
    answer = await call.read()
    assert isinstance(answer, bytes)
    return answer


def state(version: int, *rules: AccessRule) -> AccessState:
    return AccessState(version=version, cluster_id="c", rules=AccessRules(rules))


async def ended(call: Any) -> Exception:
    try:
        await call.read()
    except grpc.aio.AioRpcError as error:
        return from_rpc_error(error, "it")
    raise AssertionError(f"the call did not end with an error: {await call.code()}")


async def test_a_port_without_the_rules_serves_no_caller_that_needs_a_rule(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(admission, "STATE_SECONDS_MAX", 0.01)
    async with port() as (server, begin):
        assert await answer_to(begin(CLUSTER), "x") == b"1"
        early = begin(CLIENTS)
        await early.write(b"open")
        assert isinstance(await ended(early), Unavailable)
        server.access.set_state(state(0))
        assert await answer_to(begin(CLIENTS), "x") == b"1"


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """An event that is set once a call waits for the rules or for the keys of tokens."""
    monkeypatch.setattr(admission, "STATE_SECONDS_MAX", 20.0)
    event, wait_while = asyncio.Event(), AccessControl.wait_while

    async def noted(self: AccessControl, is_missing: Callable[[], bool], seconds_max: float) -> None:
        if is_missing():
            event.set()
        await wait_while(self, is_missing, seconds_max)

    monkeypatch.setattr(AccessControl, "wait_while", noted)
    return event


async def test_a_port_that_still_lacks_the_rules_lets_a_client_wait_but_not_a_member(waits: asyncio.Event) -> None:
    """In an earlier version, a client that connected just after the start of a front-end got the error that the
    front-end cannot serve.
    """
    async with port() as (server, begin):
        assert await answer_to(begin(CLUSTER), "x") == b"1"
        assert not waits.is_set()
        early = begin(CLIENTS)
        await early.write(b"x")
        await waits.wait()
        server.access.set_state(state(0))
        assert await early.read() == b"1"


async def test_a_port_that_still_lacks_the_keys_of_tokens_lets_only_a_caller_with_a_token_wait(
    waits: asyncio.Event,
) -> None:
    """A front-end may learn of a new cluster before the cluster has made its key."""
    key = b"k" * 32
    ends = time.time_ns() + 3600 * 10**9
    claims = TokenClaims(cluster_id="c", name="cam", roles=(Role.CLIENT,), serial="1", ends_unix_nano=ends)
    token = Secret(text=make_token(key, claims), path=Path("token"))
    async with port() as (server, begin), dial(server.address, secret=token) as cameras:
        server.access.set_state(state(0))
        assert await answer_to(begin(CLIENTS), "x") == b"1"
        assert not waits.is_set()
        early = cameras.stream_stream(READ)(timeout=20)
        await early.write(b"x")
        await waits.wait()
        server.access.set_state(replace(state(1), token_keys=(public_key(key),)))
        assert await early.read() == b"1"


async def test_a_stream_ends_when_its_caller_loses_the_right_and_other_streams_continue() -> None:
    async with port() as (server, begin):
        server.access.set_state(state(1, ALLOW))
        client, other, member = begin(CLIENTS), begin(CLIENTS), begin(CLUSTER)
        assert await answer_to(client, "open") == b"0"
        assert await answer_to(member, "open") == b"1"
        server.access.set_state(state(2, ALLOW, AccessRule("nobody", (), None, "*")))
        assert await answer_to(client, "open") == b"0"
        server.access.set_state(state(3, AccessRule("nobody", (), None, "*")))
        lost = await ended(client)
        assert isinstance(lost, PermissionDenied)
        assert "may not read channel open; an operator can allow it (stampede acl add @clients read open" in str(lost)
        assert await answer_to(member, "closed") == b"1"
        server.access.set_state(state(4, ALLOW))
        assert await answer_to(other, "open") == b"0"


async def test_the_error_says_that_a_caller_may_do_nothing_with_a_channel() -> None:
    async with port() as (server, begin):
        server.access.set_state(state(1, ALLOW))
        call = begin(CLIENTS)
        await call.write(b"closed")
        assert "may do nothing with channel closed" in str(await ended(call))


async def test_a_stream_ends_when_its_credential_is_revoked_or_has_expired() -> None:
    key, now = b"1" * 32, time.time_ns()
    claims = TokenClaims(cluster_id="c", name="cam", roles=(Role.CLIENT,), serial="a1", ends_unix_nano=now + 10**15)
    brief = replace(claims, serial="b2", ends_unix_nano=now + 2 * 10**9)
    known = AccessState(version=1, cluster_id="c", token_keys=(public_key(key),))
    async with port() as (server, _), dial(server.address, secret=None) as channel:
        server.access.set_state(known)
        calls = []
        for one in (claims, brief):
            metadata = (("authorization", f"Bearer {make_token(key, one)}"),)
            calls.append(channel.stream_stream(READ)(timeout=20, metadata=metadata))
        for call in calls:
            assert await answer_to(call, "x") == b"1"
        assert "client cam has ended; call again" in str(await ended(calls[1]))
        server.access.set_state(replace(known, version=2, revoked_serials=frozenset({"a1"})))
        assert "the token a1 of client cam was revoked" in str(await ended(calls[0]))
        second_call = channel.stream_stream(READ)(
            timeout=20, metadata=(("authorization", f"Bearer {make_token(key, claims)}"),)
        )
        assert "was revoked" in str(await ended(second_call))


@asynccontextmanager
async def open_calls(control: AccessControl, count: int, reads: int, **caller: Any) -> AsyncIterator[None]:
    """Open `count` calls of a client, each of which has read `reads` channels."""

    async def aborted(*_: Any) -> None:
        raise PermissionDenied("aborted")

    async def call() -> None:
        client = Caller(kind=CallerKind.CLIENT_SECRET, roles=frozenset(), name="@clients", **caller)
        async with control.serving(client, SimpleNamespace(peer=lambda: "here", abort=aborted)):
            for number in range(reads):
                check_access(AccessVerb.READ, AccessKind.CHANNEL, f"c{number}")
            await asyncio.Event().wait()

    tasks = [asyncio.create_task(call()) for _ in range(count)]
    await asyncio.sleep(0)
    yield
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


@pytest.mark.parametrize(("calls", "reads"), [(1, 200), (200, 1)])
async def test_new_rules_are_applied_to_a_few_rights_in_each_turn(
    monkeypatch: pytest.MonkeyPatch, calls: int, reads: int
) -> None:
    """In an earlier version, one step checked all rights of a call again. 1000 rights and 1000 rules took 120 ms."""
    control, judged, judge = AccessControl(), 0, AccessRules.judge
    allow = AccessRule("@clients", (AccessVerb.READ,), None, "*")
    control.set_state(state(1, allow))

    def counting(self: AccessRules, *what: Any) -> Any:
        nonlocal judged
        judged += 1
        return judge(self, *what)

    async with open_calls(control, calls, reads):
        monkeypatch.setattr(AccessRules, "judge", counting)
        control.set_state(state(2, allow))
        in_turns = [0]
        for _ in range(200):
            await asyncio.sleep(0)
            in_turns.append(judged)
    assert judged == 200
    most = RIGHTS_PER_TURN if calls == 1 else CALLS_PER_TURN
    assert max(after - before for before, after in pairwise(in_turns)) == most


async def test_the_calls_of_an_expired_token_end_a_few_at_a_time() -> None:
    """In an earlier version, 4096 calls ended together within two turns of the event loop, which took 40 ms."""
    now = 1
    control = AccessControl(time_unix_nano=lambda: now)
    control.set_state(state(1))
    async with open_calls(control, 100, 0, ends_unix_nano=2):
        now, calls = 2, tuple(control._open)
        control._end_expired_calls()
        left = [sum(call.error is None for call in calls)]
        for _ in range(20):
            await asyncio.sleep(0)
            left.append(sum(call.error is None for call in calls))
    assert (left[0], left[-1]) == (100 - CALLS_ENDED_PER_TURN, 0)
    assert max(before - after for before, after in pairwise(left)) == CALLS_ENDED_PER_TURN


async def test_each_turn_checks_the_credentials_of_a_few_open_calls_and_the_rounds_repeat() -> None:
    """In an earlier version, each second, one turn looked at all open calls. 3000 calls took 1.8 ms."""
    control, turns = AccessControl(time_unix_nano=lambda: 2), 1
    control.set_state(state(1))
    async with open_calls(control, 4 * CALLS_LOOKED_AT_PER_TURN - 1, 0, ends_unix_nano=5):
        control._end_expired_calls()
        while not isinstance(control._sweep, asyncio.TimerHandle):  # the timer begins the next look
            await asyncio.sleep(0)
            turns += 1
    assert turns == 4


async def test_the_requests_of_a_stream_end_one_by_one_and_a_few_at_a_time() -> None:
    """In an earlier version, a lost right ended the whole stream, with the requests that needed other rights."""
    control, lost = AccessControl(), []
    keep, take = (AccessRule("@clients", (AccessVerb.READ,), None, name) for name in ("kept", "lost"))
    control.set_state(state(1, keep, take))
    client = Caller(kind=CallerKind.CLIENT_SECRET, roles=frozenset(), name="@clients")
    async with control.serving(client, SimpleNamespace(peer=lambda: "here")):
        rights = request_rights(lambda request, error: lost.append((request, str(error))))
        for number in range(3 * REQUESTS_PER_STEP):
            rights.check(AccessVerb.READ, AccessKind.CHANNEL, "lost")
            rights.hold(number, AccessVerb.READ, AccessKind.CHANNEL, "lost")
            rights.hold(number, AccessVerb.READ, AccessKind.CHANNEL, "kept")
        rights.hold("good", AccessVerb.READ, AccessKind.CHANNEL, "kept")
        rights.release(0)
        control.set_state(state(2, keep))
        with pytest.raises(PermissionDenied, match="may not read channel lost"):
            rights.check(AccessVerb.READ, AccessKind.CHANNEL, "lost")
        [call], seen = control._open, [0]
        for _ in rights.judging_again(control.rules()):
            seen.append(len(lost))
        assert call.error is None
        rights.check(AccessVerb.READ, AccessKind.CHANNEL, "kept")
        assert [request for request, _ in lost] == [*range(1, 3 * REQUESTS_PER_STEP)]
        assert "may not read channel lost" in lost[0][1]
        assert max(after - before for before, after in pairwise(seen)) == REQUESTS_PER_STEP
        rights.release("good")
        assert not rights._waiting
        assert not rights._grants_of_requests


async def test_a_lost_right_cannot_be_used_even_before_the_call_is_judged_again() -> None:
    control = AccessControl()
    control.set_state(state(1, ALLOW))
    client = Caller(kind=CallerKind.CLIENT_SECRET, roles=frozenset(), name="@clients")
    async with control.serving(client, SimpleNamespace(peer=lambda: "here")):
        check_access(AccessVerb.READ, AccessKind.CHANNEL, "open")
        control.set_state(state(2, AccessRule("nobody", (), None, "*")))
        with pytest.raises(PermissionDenied, match="may not read channel open"):
            check_access(AccessVerb.READ, AccessKind.CHANNEL, "open")


@pytest.mark.parametrize("revoked", ["ce", "a1"])
async def test_a_call_with_a_token_ends_with_the_token_and_with_the_certificate_of_its_connection(revoked: str) -> None:
    control = AccessControl()
    control.set_state(state(1))

    async def abort(*_: Any) -> None:
        raise PermissionDenied("aborted")

    shared = Caller(kind=CallerKind.CERTIFICATE, roles=frozenset({Role.CLIENT}), name="shared", serial="ce")
    caller = Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name="cam", serial="a1", connection=shared)
    control.check_valid(caller)

    async def call() -> None:
        async with control.serving(caller, SimpleNamespace(peer=lambda: "here", abort=abort)):
            await asyncio.Event().wait()

    serving_call = asyncio.create_task(call())
    await asyncio.sleep(0)
    control.set_state(replace(state(2), revoked_serials=frozenset({revoked})))
    with pytest.raises(PermissionDenied, match="aborted"):
        await serving_call
    with pytest.raises(PermissionDenied, match=f"{revoked} of client"):
        control.check_valid(caller)


def test_a_name_that_callers_share_counts_as_no_name_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {}
    for name in ("alice", "@clients", ""):
        monkeypatch.setattr(control, "owner_name", lambda name=name: name)
        names[name] = own_name()
    assert names == {"alice": "alice", "@clients": "", "": ""}
