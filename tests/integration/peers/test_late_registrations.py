"""A registration that the network holds until the newer process of its peer or host has registered."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import StaleRegistration
from stampede_rt.v1 import (
    directory_pb2,
    directory_service_pb2,
    directory_service_pb2_grpc,
    peer_service_pb2,
    peer_service_pb2_grpc,
)
from stampede_rt_runtime.dial import dial
from tests.support.holding_relay import holding_relay
from tests.support.supernode.processes import Supernode, called, free_ports, register

ME, PROOF = b"planner-planner-", b"p" * 32
Ask = Callable[[Any, int, int], Awaitable[Any]]


@asynccontextmanager
async def stubs(address: str) -> AsyncIterator[Any]:
    """Yield the stubs of a process that calls that address."""
    channel = dial(address, secret=None)
    try:
        yield SimpleNamespace(
            hosts=directory_service_pb2_grpc.DirectoryServiceStub(channel),
            peers=peer_service_pb2_grpc.PeerServiceStub(channel),
        )
    finally:
        await channel.close()


async def register_peer(process: Any, boot: int, epoch: int) -> Any:
    request = peer_service_pb2.RegisterPeerRequest(
        request_id=secrets.token_bytes(16),
        peer_id=ME,
        name="planner",
        boot_incarnation=boot,
        proof=PROOF,
        registration_epoch=epoch,
    )
    return (await process.peers.RegisterPeer(request, timeout=50, wait_for_ready=True)).peer


async def register_host(process: Any, boot: int, epoch: int) -> Any:
    request = directory_service_pb2.RegisterHostRequest(
        request_id=secrets.token_bytes(16),
        host_id=ME,
        name="planner",
        gatekeepers=[directory_pb2.Endpoint(target="localhost:7900")],
        boot_incarnation=boot,
        registration_epoch=epoch,
    )
    return (await process.hosts.RegisterHost(request, timeout=50, wait_for_ready=True)).host


async def resolve_peer(process: Any) -> Any:
    return (await process.peers.ResolvePeer(peer_service_pb2.ResolvePeerRequest(name="planner"), timeout=50)).peer


async def resolve_host(process: Any) -> Any:
    request = directory_service_pb2.ResolveHostRequest(name="planner")
    return (await process.hosts.ResolveHost(request, timeout=50)).host


@pytest.mark.parametrize(
    ("enter", "find"),
    [pytest.param(register_peer, resolve_peer, id="peer"), pytest.param(register_host, resolve_host, id="host")],
)
async def test_late_requests_of_a_killed_process_change_nothing_after_its_successor_has_registered(
    enter: Ask, find: Callable[[Any], Awaitable[Any]]
) -> None:
    """In an earlier version, the directory performed the late request.

    It took the name and the mailbox, or all channels, from the live process.
    """
    address = f"127.0.0.1:{free_ports(1)[0]}"
    one = Supernode("s1", address, ["--listen", address])
    try:
        await one.start()
        await register(one, 1)
        async with holding_relay(address) as (relay, slow), stubs(slow) as killed, stubs(address) as newer:
            await called(enter(newer, 1, 0), one)
            with pytest.raises(StaleRegistration):
                await called(enter(killed, 2, 0), one)
            relay.hold()
            late = asyncio.ensure_future(called(enter(killed, 2, 1), one))
            await relay.holds_something.wait()
            with pytest.raises(StaleRegistration):
                await called(enter(newer, 3, 0), one)
            lives = await called(enter(newer, 3, 1), one)
            relay.release()
            with pytest.raises(StaleRegistration, match="registers with epoch 2"):
                await late
            assert (await find(newer)).boot_incarnation == lives.boot_incarnation == 3
    finally:
        await one.close()
