"""Faults of channel hosts: killed, stopped and cut off. A host must accept no put after its lease has ended."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from tests.robustness.faults.kills_and_cuts import KILLED, STOPPED, cut
from tests.robustness.faults.scene import PATIENCE_SECONDS, RECOVERY_SECONDS_MAX, Fault, Scene
from tests.robustness.real_cluster.cluster import Host
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect, PlacedProcess
from tests.robustness.real_cluster.supernode import LEASE_TTL_SECONDS
from tests.robustness.real_cluster.traffic import CLIENT, Traffic
from tests.support.channel_host.rig import run_of

STALE_PUTS = 10
RETRY_SECONDS = 0.05


@dataclass(frozen=True, slots=True)
class PinnedChannel:
    """A channel of this test at one host, with an item in it."""

    channel: aio.Channel
    host: Host
    before: st.ChannelInfo
    incarnation: int


async def kill_host(scene: Scene) -> None:
    """Kill a host. Its channels get a new owner when its lease has ended."""
    pinned = await pin(scene)
    began = time.monotonic()
    await pinned.host.kill()
    recovery = await _put_again(scene, pinned, began)
    evidence = f"{KILLED}; {_reopened(pinned)}"
    await started(pinned.host)
    await _read(scene, pinned)
    scene.ended("host: kill -9, its channels go to other hosts", began, recovery, evidence=evidence)


async def restart_host(scene: Scene) -> None:
    """Kill a host, and start it again within its lease.

    Its channels stay at this host, empty, with a new incarnation.
    """
    pinned = await pin(scene)
    began = time.monotonic()
    await pinned.host.kill()
    await started(pinned.host)
    recovery = await _put_again(scene, pinned, began)
    await _read(scene, pinned)
    start = f"the host needed {pinned.host.start_seconds:.2f} s to start"
    evidence = f"{KILLED}; {_reopened(pinned)}"
    scene.ended("host: kill -9 and a restart", began, recovery, evidence=evidence, note=start)


async def kill_all_hosts(scene: Scene) -> None:
    """Kill all hosts together, and start them again immediately."""
    pinned = await pin(scene)
    began = time.monotonic()
    for host in scene.cluster.hosts:
        await host.kill()
    await asyncio.gather(*(started(host) for host in scene.cluster.hosts))
    recovery = await _put_again(scene, pinned, began)
    await _read(scene, pinned)
    slowest = max(host.start_seconds for host in scene.cluster.hosts)
    evidence = f"{KILLED}; {_reopened(pinned)}"
    kind = "host: kill -9 of all"
    scene.ended(
        kind,
        began,
        recovery,
        evidence=evidence,
        majority=False,
        note=f"the slowest host needed {slowest:.2f} s to start",
    )


async def kill_frontend(scene: Scene) -> None:
    """Kill the front-end. Connected clients continue without it, and can also make new channels."""
    frontend = scene.cluster.frontend
    assert frontend is not None
    began = time.monotonic()
    await frontend.kill()
    pinned = await pin(scene)
    recovery = time.monotonic() - began
    await started(frontend)
    note = f"a channel was made and a put acknowledged at {pinned.host.name} without it"
    scene.ended("front-end: kill -9", began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=KILLED, note=note)


async def kill_everything(scene: Scene) -> None:
    """Kill supernodes, front-end and hosts together, and start them immediately, as after a power failure."""
    pinned = await pin(scene)
    began = time.monotonic()
    for one in scene.cluster.processes():
        one.signal(signal.SIGKILL)
    for one in scene.cluster.processes():
        await one.kill()
        await one.launch()
    await asyncio.gather(*(one.wait_until_ready() for one in scene.cluster.processes()))
    up = time.monotonic() - began
    recovery = await _put_again(scene, pinned, began)
    await _read(scene, pinned)
    evidence = f"{KILLED}, {len(scene.cluster.processes())} times; {_reopened(pinned)}"
    note = f"all processes were ready, and the hosts registered, after {up:.2f} s"
    scene.ended("everything: kill -9 of all processes", began, recovery, evidence=evidence, majority=False, note=note)


async def freeze_host(scene: Scene) -> None:
    """Stop a host for longer than its lease. When it goes on, it must refuse the puts that have arrived meanwhile."""
    pinned = await pin(scene)
    async with _direct(scene, pinned.host) as connection:
        if not await _accepted(connection, pinned):
            raise FaultHadNoEffect(f"{pinned.host.name} takes no put under the epoch that is in force")
        began = time.monotonic()
        await pinned.host.freeze()
        try:
            await asyncio.sleep(scene.rng.uniform(0.0, 1.0))
            waiting = [asyncio.create_task(_accepted(connection, pinned)) for _ in range(STALE_PUTS)]
            recovery = await _put_again(scene, pinned, began)
            given_away = time.monotonic()
            late = [asyncio.create_task(_accepted(connection, pinned)) for _ in range(STALE_PUTS)]
            await asyncio.sleep(scene.rng.uniform(0.1, 2.0))
        finally:
            pinned.host.thaw()
        _check_refused(pinned, await asyncio.gather(*waiting, *late, _accepted(connection, pinned)))
    evidence = f"{STOPPED} for {time.monotonic() - began:.1f} s; {_reopened(pinned)}"
    count, sent_after = 2 * STALE_PUTS + 1, given_away - began
    note = f"{count} puts under the old epoch were refused, some sent {sent_after:.1f} s after the stop"
    scene.ended("host: SIGSTOP beyond its lease", began, recovery, evidence=evidence, note=note)


async def cut_off_host(scene: Scene) -> None:
    """Cut a host off from the supernodes, but not from callers.

    The host must fence itself before its channels get a new owner.
    """
    pinned = await pin(scene)
    namespaces = [one.namespace for one in scene.cluster.supernodes]
    pairs = [(pinned.host.namespace, namespace) for namespace in namespaces] + [
        (namespace, pinned.host.namespace) for namespace in namespaces
    ]
    async with _direct(scene, pinned.host) as connection:
        began = time.monotonic()
        trying = asyncio.create_task(_last_accepted(connection, pinned))
        async with cut(scene, pairs) as seen:
            recovery = await _put_again(scene, pinned, began)
            given_away = time.monotonic()
            last = await trying
            _check_refused(pinned, [await _accepted(connection, pinned)])
        if last > given_away:
            raise AssertionError(f"{pinned.host.name} took a put after {pinned.channel.host} had taken one")
    evidence = f"{seen}; {_reopened(pinned)}"
    note = (
        f"the old owner acknowledged its last put {last - began:.2f} s after the cut; "
        f"the new owner acknowledged its first one after {given_away - began:.2f} s"
    )
    scene.ended("host: cut off from all supernodes", began, recovery, evidence=evidence, note=note)


def _traffic(scene: Scene) -> Traffic:
    assert scene.traffic is not None, "this fault is for clusters with channel hosts"
    return scene.traffic


async def pin(scene: Scene) -> PinnedChannel:
    """Make a channel at one host, with an item. Raises StampedeError if the cluster has no such host."""
    traffic = _traffic(scene)
    host = scene.rng.choice(scene.cluster.hosts)
    channel = await traffic.open(f"robust-pinned/{time.monotonic_ns()}", host=host.name)
    item = await traffic.put(channel)
    if channel.host != host.name:
        raise FaultHadNoEffect(f"the channel is at {channel.host}, not at {host.name}")
    return PinnedChannel(channel, host, channel.info, item.incarnation)


async def _put_again(scene: Scene, pinned: PinnedChannel, since: float) -> float:
    """Put until a put is acknowledged under another incarnation.

    Returns the time since `since`. Raises TimeoutError.
    """
    traffic = _traffic(scene)
    async with asyncio.timeout(PATIENCE_SECONDS):
        while True:
            try:
                item = await traffic.put(pinned.channel)
            except st.StampedeError:
                pass  # the channel has no owner at the moment
            else:
                if item.incarnation != pinned.incarnation:
                    return time.monotonic() - since
            await asyncio.sleep(RETRY_SECONDS)


def _reopened(pinned: PinnedChannel) -> str:
    """Check that the channel has a higher epoch and another incarnation, so that callers learn of the loss.

    Returns the evidence. Raises AssertionError.
    """
    after = pinned.channel.info
    if after.epoch <= pinned.before.epoch or after.incarnation == pinned.incarnation:
        raise AssertionError(f"the channel is at epoch {after.epoch} in the same incarnation after its host was lost")
    return f"from {pinned.host.name}, epoch {pinned.before.epoch}, to {after.host}, epoch {after.epoch}"


async def _read(scene: Scene, pinned: PinnedChannel) -> None:
    """Read the channel's items into the history, which is judged at the end of the campaign."""
    await _traffic(scene).read_all(pinned.channel)


async def started(one: PlacedProcess) -> None:
    """Start the process. Raises TimeoutError."""
    if not await one.start():
        raise TimeoutError(f"{one.name} did not start again: {one.last_log_line()!r}")


def _direct(scene: Scene, host: Host) -> grpc.aio.Channel:
    files = scene.cluster.caller_files(Role.CLIENT, CLIENT)
    return dial(host.address, secret=None, tls=None if files is None else TlsReader(files))


async def _accepted(connection: grpc.aio.Channel, pinned: PinnedChannel) -> bool:
    """Whether the host takes a put under the epoch of `pinned.before`, as a caller with an old binding sends it."""
    request = pb.PutRequest(
        channel_id=pinned.before.channel_id, epoch=pinned.before.epoch, puts=[run_of(b"stale", number=1)]
    )
    call: Any = ChannelServiceStub(connection).Put(iter((request,)), timeout=PATIENCE_SECONDS)
    try:
        acks = [ack async for response in call for ack in response.acks]
    except grpc.aio.AioRpcError as error:
        if not from_rpc_error(error, pinned.host.name).retryable:
            raise
        return False
    return any(ack.HasField("first_seq") for ack in acks)


async def _last_accepted(connection: grpc.aio.Channel, pinned: PinnedChannel) -> float:
    """Put under the old epoch until the host refuses. Returns the time at which the last accepted put was sent."""
    last = sent = time.monotonic()
    deadline = sent + 2 * LEASE_TTL_SECONDS
    while await _accepted(connection, pinned):
        last = sent
        if last > deadline:
            raise AssertionError(f"{pinned.host.name} serves {2 * LEASE_TTL_SECONDS} s after it was cut off")
        await asyncio.sleep(RETRY_SECONDS)
        sent = time.monotonic()
    return last


def _check_refused(pinned: PinnedChannel, accepted: Sequence[bool]) -> None:
    if any(accepted):
        epoch = pinned.before.epoch
        raise AssertionError(f"{pinned.host.name} took {sum(accepted)} puts under epoch {epoch}, which had ended")


FAULTS: dict[str, Fault] = {
    "kill_host": kill_host,
    "restart_host": restart_host,
    "kill_all_hosts": kill_all_hosts,
    "freeze_host": freeze_host,
    "cut_off_host": cut_off_host,
    "kill_frontend": kill_frontend,
    "kill_everything": kill_everything,
}
