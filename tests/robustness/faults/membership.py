"""Supernodes join and leave during other faults, by the commands of the runbook."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import grpc

from stampede_rt.v1 import directory_service_pb2 as pb
from tests.robustness.faults.kills_and_cuts import cut
from tests.robustness.faults.scene import PATIENCE_SECONDS, RECOVERY_SECONDS_MAX, Fault, Scene
from tests.robustness.real_cluster.cluster import serves
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect
from tests.robustness.real_cluster.supernode import Supernode

REMOVED_SECONDS = 10.0
PAUSE_SECONDS = 0.5


async def grow_and_shrink(scene: Scene) -> None:
    """Let a fourth supernode join and remove a follower, while another supernode has a fault."""
    began = time.monotonic()
    troubled = scene.rng.choice(scene.cluster.supernodes)
    async with _trouble(scene, troubled) as trouble:
        newcomer = await _join(scene)
        leader = await scene.cluster.leader()
        leaver = next(one for one in scene.cluster.others(leader) if one not in (newcomer, troubled))
        await _remove(scene, leaver)
    recovery = await scene.recovery(began)
    evidence = await _listed(scene, newcomer, leaver)
    kind, note = "membership: one joins, a follower is removed", f"at the same time, {trouble}"
    scene.ended(kind, began, recovery, evidence=evidence, note=note)


async def remove_leader(scene: Scene) -> None:
    """Let a fourth supernode join, and remove the leader, which first hands over."""
    began = time.monotonic()
    newcomer = await _join(scene)
    leader = await scene.cluster.leader()
    removed = time.monotonic()
    await _remove(scene, leader)
    recovery = await scene.recovery(removed)
    evidence = await _listed(scene, newcomer, leader)
    kind = "membership: one joins, the leader is removed"
    scene.ended(kind, began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence)


async def replace_dead(scene: Scene) -> None:
    """Replace a supernode that died with its disk: remove it, and let another join under a new id, during another
    fault.
    """
    _, dead, _ = await scene.leader_and_other()
    began = time.monotonic()
    await dead.kill()
    recovery = await scene.recovery(began)
    await _command(scene, "remove", dead.name)
    await scene.cluster.forget(dead)
    async with _trouble(scene, scene.rng.choice(scene.cluster.supernodes)) as trouble:
        newcomer = await _join(scene)
    evidence = await _listed(scene, newcomer, dead)
    kind = "membership: a dead one is replaced by one that joins"
    note = f"at the same time, {trouble}, while only two supernodes were left, both of which are needed for a majority"
    scene.ended(kind, began, recovery, limit_s=RECOVERY_SECONDS_MAX, majority=False, evidence=evidence, note=note)


async def volunteer_leaves(scene: Scene) -> None:
    """Remove a supernode right after it joined, before it ever led. Later another supernode takes its place."""
    began = time.monotonic()
    newcomer = await _join(scene)
    await _remove(scene, newcomer)
    recovery = await scene.recovery(began)
    evidence = await _listed(scene, None, newcomer)
    scene.ended("membership: a volunteer joins and leaves", began, recovery, evidence=evidence)


async def _join(scene: Scene) -> Supernode:
    """Prepare a newcomer, start it, and let it join. Raises TimeoutError."""
    newcomer = scene.cluster.newcomer()
    listen = ["--data-dir", str(newcomer.data_dir), "--listen", newcomer.address, "--id", newcomer.name]
    try:
        await _command(scene, "join", *listen)
        if not await newcomer.start():
            raise TimeoutError(f"{newcomer.name} ended instead of joining: {newcomer.last_log_line()!r}")
        scene.cluster.supernodes.append(newcomer)
        await serves(newcomer, time.monotonic() + PATIENCE_SECONDS)
    except BaseException:
        await scene.cluster.forget(newcomer)
        raise
    return newcomer


async def _remove(scene: Scene, one: Supernode) -> None:
    """Remove a supernode, and wait until it ends by itself. Raises FaultHadNoEffect if it goes on."""
    await _command(scene, "remove", one.name)
    scene.cluster.supernodes.remove(one)
    try:
        async with asyncio.timeout(REMOVED_SECONDS):
            await one.ended()
    except TimeoutError:
        raise FaultHadNoEffect(f"{one.name} was removed {REMOVED_SECONDS} s ago and still runs") from None
    finally:
        await scene.cluster.forget(one)


async def _command(scene: Scene, verb: str, *words: str) -> None:
    """Run `stampede supernode VERB` until it succeeds. It is refused while no majority serves."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while True:
        members = ",".join(one.address for one in scene.cluster.supernodes)
        code, printed = await scene.cluster.command(verb, *words, "--member", members)
        if code == 0:
            return
        if time.monotonic() > deadline:
            raise TimeoutError(f"stampede supernode {verb} {' '.join(words)}: {printed.strip()}")
        await asyncio.sleep(PAUSE_SECONDS)


async def _listed(scene: Scene, newcomer: Supernode | None, leaver: Supernode) -> str:
    """Wait until all members list the newcomer and not the removed one. Raises FaultHadNoEffect."""
    wanted = {one.name for one in scene.cluster.supernodes}
    assert newcomer is None or newcomer.name in wanted
    assert leaver.name not in wanted
    deadline = time.monotonic() + PATIENCE_SECONDS
    for one in scene.cluster.supernodes:
        seen: set[str] = set()
        while seen != wanted:
            if time.monotonic() > deadline:
                raise FaultHadNoEffect(f"{one.name} lists {sorted(seen)} as the members, not {sorted(wanted)}")
            with contextlib.suppress(grpc.aio.AioRpcError):
                listed = await one.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=2)
                seen = {record.supernode_id for record in listed.supernodes}
            await asyncio.sleep(0.05)
    joined = f"{newcomer.name} joined, " if newcomer is not None else ""
    return f"{joined}{leaver.name} left; all list {', '.join(sorted(wanted))}"


@asynccontextmanager
async def _trouble(scene: Scene, victim: Supernode) -> AsyncIterator[str]:
    """Kill, stop or cut off `victim` for a moment, soon after the block began. Yields a text about it."""
    kinds: dict[str, Callable[[Scene, Supernode], Awaitable[None]]] = {
        "kill -9": _kill_for_a_moment,
        "SIGSTOP": _freeze_for_a_moment,
        "a partition": _cut_off_for_a_moment,
    }
    kind = scene.rng.choice(sorted(kinds))

    async def later() -> None:
        await asyncio.sleep(scene.rng.uniform(0.0, 2.0))
        await kinds[kind](scene, victim)

    task = asyncio.create_task(later())
    try:
        yield f"{kind} of {victim.name}"
    finally:
        await task


async def _kill_for_a_moment(_scene: Scene, victim: Supernode) -> None:
    await victim.kill()
    await victim.start()


async def _freeze_for_a_moment(scene: Scene, victim: Supernode) -> None:
    await victim.freeze()
    await asyncio.sleep(scene.rng.uniform(1.0, 3.0))
    victim.thaw()


async def _cut_off_for_a_moment(scene: Scene, victim: Supernode) -> None:
    others = [one.namespace for one in scene.cluster.others(victim)]
    pairs = [(victim.namespace, other) for other in others] + [(other, victim.namespace) for other in others]
    async with cut(scene, pairs):
        await asyncio.sleep(scene.rng.uniform(1.0, 3.0))


FAULTS: dict[str, Fault] = {
    "grow_and_shrink": grow_and_shrink,
    "remove_leader": remove_leader,
    "replace_dead": replace_dead,
    "volunteer_leaves": volunteer_leaves,
}
