"""Processes killed and stopped, networks cut. Each does its harm, waits for what must hold, and heals."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Sequence

import grpc

from tests.robustness.cluster import Supernode
from tests.robustness.scene import (
    FROZEN_LEADER_SECONDS_MAX,
    PATIENCE_SECONDS,
    RECOVERY_SECONDS_MAX,
    Fault,
    Scene,
)


async def kill_leader(scene: Scene) -> None:
    leader, _, _ = await scene.leader_and_other()
    began = time.monotonic()
    await leader.kill()
    recovery = await scene.recovery(began)
    await leader.start()
    scene.ended("kill -9 of the leader", began, recovery, RECOVERY_SECONDS_MAX)


async def kill_follower(scene: Scene) -> None:
    _, follower, _ = await scene.leader_and_other()
    began = time.monotonic()
    await follower.kill()
    recovery = await scene.recovery(began)
    await follower.start()
    scene.ended("kill -9 of a follower", began, recovery, RECOVERY_SECONDS_MAX)


async def kill_all(scene: Scene) -> None:
    """All at once, started again at once: the recovery includes the start of the processes."""
    began = time.monotonic()
    for one in scene.cluster.supernodes:
        one.signal(signal.SIGKILL)
    for one in scene.cluster.supernodes:
        await one.ended()
        await one.launch()
    recovering = asyncio.create_task(scene.recovery(began))
    for one in scene.cluster.supernodes:
        await one.said_ready()
    note = f"the last process was up after {time.monotonic() - began:.2f} s"
    scene.ended("kill -9 of all", began, await recovering, RECOVERY_SECONDS_MAX, majority=False, note=note)


async def freeze_leader(scene: Scene) -> None:
    leader, _, _ = await scene.leader_and_other()
    began = time.monotonic()
    leader.signal(signal.SIGSTOP)
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.dice.uniform(0.0, 3.0))
    finally:
        leader.signal(signal.SIGCONT)
    scene.ended("SIGSTOP of the leader", began, recovery, FROZEN_LEADER_SECONDS_MAX)


async def freeze_follower(scene: Scene) -> None:
    _, follower, _ = await scene.leader_and_other()
    began = time.monotonic()
    follower.signal(signal.SIGSTOP)
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.dice.uniform(2.0, 6.0))
    finally:
        follower.signal(signal.SIGCONT)
    scene.ended("SIGSTOP of a follower", began, recovery, RECOVERY_SECONDS_MAX)


async def _partition(scene: Scene, kind: str, pairs: Sequence[tuple[Supernode, Supernode]]) -> None:
    """Nothing passes from the first to the second of each pair. Callers reach everybody."""
    began = time.monotonic()
    try:
        for sender, receiver in pairs:
            scene.cluster.network.block(sender.place, receiver.place)
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.dice.uniform(3.0, 6.0))
    finally:
        scene.cluster.network.unblock_all()
    scene.ended(kind, began, recovery)


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
    leader, _, _ = await scene.leader_and_other()
    began = time.monotonic()
    scene.cluster.network.plug(leader.place, in_=False)
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(scene.dice.uniform(1.0, 3.0))
    finally:
        scene.cluster.network.plug(leader.place, in_=True)
    scene.ended("the leader's link down", began, recovery)


async def past_compaction(scene: Scene) -> None:
    """A follower is away for longer than the others keep their log: it needs a snapshot."""
    leader, away, other = await scene.leader_and_other()
    began = time.monotonic()
    pairs = [(leader, away), (away, leader), (other, away), (away, other)]
    try:
        for sender, receiver in pairs:
            scene.cluster.network.block(sender.place, receiver.place)
        _, index = await leader.members_seen()
        await _grow(scene, leader, index + 1000)
    finally:
        scene.cluster.network.unblock_all()
    healed = time.monotonic()
    _, target = await leader.members_seen()
    await _grow(scene, away, target, write=False)
    took = time.monotonic() - healed
    scene.ended("partition past log compaction", began, note=f"level again {took:.1f} s after it healed")


async def _grow(scene: Scene, one: Supernode, target: int, *, write: bool = True) -> None:
    """Wait until `one` has applied up to `target`; `write` what is needed for that."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < deadline:
        try:
            if (await one.members_seen())[1] >= target:
                return
        except grpc.aio.AioRpcError:
            pass  # asked again below
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
