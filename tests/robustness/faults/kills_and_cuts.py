"""Faults that kill and stop processes and cut networks.

Each function injects its fault, checks that the fault took effect, waits until the directory serves again, and heals
the fault.
"""

from __future__ import annotations

import asyncio
import itertools
import signal
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import grpc

from stampede_rt_local.namespaces import NetworkNamespace
from tests.robustness.faults.scene import (
    FROZEN_LEADER_SECONDS_MAX,
    PATIENCE_SECONDS,
    RECOVERY_SECONDS_MAX,
    Fault,
    Scene,
)
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect, PlacedProcess
from tests.robustness.real_cluster.supernode import Supernode

KILLED, STOPPED = "ended by signal 9", "in kernel state T"


async def kill_leader(scene: Scene) -> None:
    leader, _, _ = await scene.leader_and_other()
    began = time.monotonic()
    await leader.kill()
    recovery = await scene.recovery(began)
    await leader.start()
    scene.ended("kill -9 of the leader", began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=KILLED)


async def kill_follower(scene: Scene) -> None:
    _, follower, _ = await scene.leader_and_other()
    began = time.monotonic()
    await follower.kill()
    recovery = await scene.recovery(began)
    await follower.start()
    scene.ended("kill -9 of a follower", began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=KILLED)


async def kill_all(scene: Scene) -> None:
    """Kill all supernodes together, and start them immediately.

    The recovery includes their start. The report also gives the time of the start alone.
    """
    began = time.monotonic()
    for one in scene.cluster.supernodes:
        one.signal(signal.SIGKILL)
    for one in scene.cluster.supernodes:
        await one.kill()
        await one.launch()
    recovering = asyncio.create_task(scene.recovery(began))
    up = await asyncio.gather(*(_up_after(one, began) for one in scene.cluster.supernodes))
    majority_up = sorted(up)[len(up) // 2]
    scene.ended(
        "kill -9 of all",
        began,
        await recovering,
        limit_s=RECOVERY_SECONDS_MAX,
        start_s=majority_up,
        majority=False,
        evidence=KILLED,
        note=f"a majority of the processes was up after {majority_up:.2f} s, the last after {max(up):.2f} s",
    )


async def _up_after(one: Supernode, began: float) -> float:
    await one.wait_until_ready()
    return time.monotonic() - began


async def freeze_leader(scene: Scene) -> None:
    leader, _, _ = await scene.leader_and_other()
    began = time.monotonic()
    await leader.freeze()
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.rng.uniform(0.0, 3.0))
        _check_stopped(leader)
    finally:
        leader.thaw()
    scene.ended("SIGSTOP of the leader", began, recovery, limit_s=FROZEN_LEADER_SECONDS_MAX, evidence=STOPPED)


async def freeze_follower(scene: Scene) -> None:
    _, follower, _ = await scene.leader_and_other()
    began = time.monotonic()
    await follower.freeze()
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.rng.uniform(2.0, 6.0))
        _check_stopped(follower)
    finally:
        follower.thaw()
    scene.ended("SIGSTOP of a follower", began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=STOPPED)


def _check_stopped(one: PlacedProcess) -> None:
    if one.kernel_state() != "T":
        raise FaultHadNoEffect(
            f"{one.name} runs although the fault stopped it: it is in kernel state {one.kernel_state()}"
        )


Pairs = Sequence[tuple[NetworkNamespace, NetworkNamespace]]


@asynccontextmanager
async def cut(scene: Scene, pairs: Pairs) -> AsyncIterator[str]:
    """Cut the direction from the first to the second of each pair during the block.

    Yields the evidence. Raises FaultHadNoEffect.
    """
    network = scene.cluster.network
    try:
        for sender, receiver in pairs:
            network.block(sender, receiver)
        yield await asyncio.to_thread(_check_ways, scene, pairs)
    finally:
        network.unblock_all()


def _check_ways(scene: Scene, pairs: Pairs) -> str:
    """Send a datagram in each direction between all supernodes and cut processes.

    Check that datagrams arrive in all directions except the cut ones.
    """
    namespaces = {namespace for pair in pairs for namespace in pair} | {
        one.namespace for one in scene.cluster.supernodes
    }
    arrived = scene.cluster.network.open_directions(namespaces)
    every = set(itertools.permutations(namespaces, 2))
    if arrived != every - set(pairs):
        wrong = [f"{sender.address} to {receiver.address}" for sender, receiver in arrived ^ (every - set(pairs))]
        raise FaultHadNoEffect(f"wrongly open or blocked: from {', from '.join(wrong)}")
    return f"datagrams do not arrive on {len(pairs)} of {len(every)} directed links"


async def _partition(scene: Scene, kind: str, pairs: Sequence[tuple[Supernode, Supernode]]) -> None:
    """Cut the pairs. Callers still reach all supernodes."""
    began = time.monotonic()
    async with cut(scene, [(sender.namespace, receiver.namespace) for sender, receiver in pairs]) as evidence:
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.rng.uniform(3.0, 6.0))
    scene.ended(kind, began, recovery, evidence=evidence)


async def split_off_leader(scene: Scene) -> None:
    leader, first, second = await scene.leader_and_other()
    pairs = [(leader, first), (first, leader), (leader, second), (second, leader)]
    await _partition(scene, "symmetric partition: the leader alone", pairs)


async def split_off_follower(scene: Scene) -> None:
    leader, first, second = await scene.leader_and_other()
    pairs = [(leader, first), (first, leader), (first, second), (second, first)]
    await _partition(scene, "symmetric partition: a follower alone", pairs)


async def deaf_leader(scene: Scene) -> None:
    leader, first, second = await scene.leader_and_other()
    await _partition(scene, "one-way partition: the leader hears nobody", [(first, leader), (second, leader)])


async def mute_leader(scene: Scene) -> None:
    leader, first, second = await scene.leader_and_other()
    await _partition(scene, "one-way partition: nobody hears the leader", [(leader, first), (leader, second)])


async def bridge(scene: Scene) -> None:
    leader, first, _ = await scene.leader_and_other()
    await _partition(scene, "bridging partition: only one follower sees all", [(leader, first), (first, leader)])


async def unplug_leader(scene: Scene) -> None:
    leader, other, _ = await scene.leader_and_other()
    network = scene.cluster.network
    began = time.monotonic()
    network.set_link(leader.namespace, up=False)
    try:
        if await asyncio.to_thread(network.open_directions, (other.namespace, leader.namespace)):
            raise FaultHadNoEffect(f"{leader.name} is reached although its link is down")
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.rng.uniform(1.0, 3.0))
    finally:
        network.set_link(leader.namespace, up=True)
    scene.ended("the leader's link down", began, recovery, evidence="no datagram reaches the leader")


async def past_compaction(scene: Scene) -> None:
    """Cut a follower off for longer than the others keep their log, so that it needs a snapshot."""
    leader, away, other = await scene.leader_and_other()
    began = time.monotonic()
    pairs = [(leader, away), (away, leader), (other, away), (away, other)]
    async with cut(scene, [(sender.namespace, receiver.namespace) for sender, receiver in pairs]):
        _, left_at = await away.leader_and_applied_index()
        _, index = await leader.leader_and_applied_index()
        await _grow(scene, leader, index + 1000)
        kept = await asyncio.to_thread(leader.first_index_kept)
        if kept <= left_at + 1:
            raise FaultHadNoEffect(
                f"{leader.name} has its log from {kept} on, and {away.name} needs it from {left_at + 1}"
            )
    healed = time.monotonic()
    _, target = await leader.leader_and_applied_index()
    await _grow(scene, away, target, write=False)
    took = time.monotonic() - healed
    evidence = f"the follower had applied the log up to {left_at}, and the leader's log began at {kept}"
    scene.ended(
        "partition past log compaction",
        began,
        evidence=evidence,
        note=f"the follower had caught up {took:.1f} s after the partition healed",
    )


async def _grow(scene: Scene, one: Supernode, target: int, *, write: bool = True) -> None:
    """Wait until `one` has applied the log up to `target`. With `write`, write as many entries as that needs."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < deadline:
        try:
            if (await one.leader_and_applied_index())[1] >= target:
                return
        except grpc.aio.AioRpcError:
            pass  # the next round asks again
        if write:
            await asyncio.gather(*(scene.probe.write(one) for _ in range(50)))
        else:
            await asyncio.sleep(0.05)
    raise TimeoutError(f"{one.name} did not come to log position {target} within {PATIENCE_SECONDS} s")


FAULTS: dict[str, Fault] = {
    "kill_leader": kill_leader,
    "kill_follower": kill_follower,
    "kill_all": kill_all,
    "freeze_leader": freeze_leader,
    "freeze_follower": freeze_follower,
    "split_off_leader": split_off_leader,
    "split_off_follower": split_off_follower,
    "deaf_leader": deaf_leader,
    "mute_leader": mute_leader,
    "bridge": bridge,
    "unplug_leader": unplug_leader,
    "past_compaction": past_compaction,
}
