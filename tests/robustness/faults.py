"""Faults that really happen to real supernodes. Each does its harm, waits for what must hold, and heals."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import random
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import grpc

from tests.robustness.callers import Probe
from tests.robustness.cluster import PORT, Cluster, Supernode

RECOVERY_SECONDS_MAX, FROZEN_LEADER_SECONDS_MAX = 5.0, 4.0
PATIENCE_SECONDS = 40.0
GARBAGE_CONNECTIONS = 12


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one fault. `recovery_s`: from the harm to the acknowledgement of a write begun after it."""

    kind: str
    began: float
    ended: float
    recovery_s: float | None = None
    limit_s: float | None = None
    majority: bool = True  # of the supernodes was alive and connected all the time
    note: str = ""
    failed: bool = False


@dataclass
class Scene:
    """Where faults happen."""

    cluster: Cluster
    probe: Probe
    dice: random.Random
    folder: Path
    outcomes: list[Outcome] = field(default_factory=list)

    async def recovery(self, since: float) -> float:
        """How long after `since` the directory served again."""
        return await self.probe.serves_after(since, seconds=PATIENCE_SECONDS)

    async def leader_and_other(self) -> tuple[Supernode, Supernode, Supernode]:
        leader = await self.cluster.leader()
        first, second = self.dice.sample(self.cluster.others(leader), 2)
        return leader, first, second

    def ended(
        self,
        kind: str,
        began: float,
        recovery_s: float | None = None,
        limit_s: float | None = None,
        *,
        majority: bool = True,
        note: str = "",
        failed: bool = False,
    ) -> None:
        """Take the fault down, which ends now."""
        outcome = Outcome(kind, began, time.monotonic(), recovery_s, limit_s, majority, note, failed)
        self.outcomes.append(outcome)
        measured = "" if recovery_s is None else f" served again after {recovery_s:.2f} s"
        print(f"{outcome.ended:10.1f}  {kind}{measured} {note}", flush=True)


Fault = Callable[[Scene], Awaitable[None]]


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


async def full_disk(scene: Scene) -> None:
    """The disk of one supernode, a small tmpfs, has no byte left for a while."""
    victim = scene.cluster.supernodes[-1]
    began = time.monotonic()
    ballast = victim.data_dir / "ballast"
    with ballast.open("wb", buffering=0) as file:
        try:
            while file.write(b"\0" * 4096):
                pass
        except OSError:
            pass  # full, as wanted
    recovery = await scene.recovery(began)
    for _ in range(30):  # its write-ahead log has some room of its own; writes enough to need more
        if not victim.running:
            break
        await asyncio.gather(*(scene.probe.write(scene.cluster.supernodes[0]) for _ in range(50)))
    died = await _has_ended(victim, within_s=3.0)
    ballast.unlink()
    if died:
        await victim.start()
    note = f"it ended ({victim.last_words()[:120]!r}) and was started again" if died else "it went on"
    scene.ended("full disk", began, recovery, note=note)


async def _has_ended(one: Supernode, *, within_s: float) -> bool:
    """Whether it ends by then: what writes its last words takes a moment."""
    try:
        async with asyncio.timeout(within_s):
            await one.ended()
    except TimeoutError:
        return False
    return True


async def _damage(scene: Scene, kind: str, harm: Callable[[Path], str]) -> None:
    """Kill a supernode, damage a file of its store, start it: it must refuse, or serve nothing wrong."""
    _, victim, _ = await scene.leader_and_other()
    began = time.monotonic()
    await victim.kill()
    spare = scene.folder / "spare"
    shutil.copytree(victim.data_dir, spare)
    files = [file for file in sorted(victim.data_dir.rglob("*")) if file.is_file() and file.stat().st_size > 0]
    what = harm(scene.dice.choice(files))
    started = await victim.start()
    note = f"{what}: " + ("harmless, it serves" if started else f"refused: {victim.last_words()[:160]!r}")
    await asyncio.sleep(2.0)  # what it would say wrong, the callers hear now
    if not started or not victim.running:
        await victim.kill()
        for file in victim.data_dir.iterdir():
            file.unlink() if file.is_file() else shutil.rmtree(file)
        shutil.copytree(spare, victim.data_dir, dirs_exist_ok=True)
        await victim.start()
    shutil.rmtree(spare)
    scene.ended(kind, began, await scene.recovery(began), note=note)


async def flip_bit(scene: Scene) -> None:
    def harm(file: Path) -> str:
        data = bytearray(file.read_bytes())
        position = scene.dice.randrange(len(data))
        data[position] ^= 1 << scene.dice.randrange(8)
        file.write_bytes(data)
        return f"{file.name}, byte {position} of {len(data)}"

    await _damage(scene, "flipped bit in a store file", harm)


async def truncate(scene: Scene) -> None:
    def harm(file: Path) -> str:
        size = file.stat().st_size
        left = scene.dice.randrange(size)
        os.truncate(file, left)
        return f"{file.name}, {left} of {size} bytes left"

    await _damage(scene, "truncated store file", harm)


async def step_clock(scene: Scene) -> None:
    seconds = scene.dice.choice([-3600.0, 3600.0, -10 * 365 * 86400.0, 10 * 365 * 86400.0])
    victims = scene.dice.choice([scene.cluster.supernodes, [await scene.cluster.leader()]])
    began = time.monotonic()
    for one in victims:
        one.step_wall_clock(seconds)
    recovery = await scene.recovery(began)
    await asyncio.sleep(3.0)
    for one in victims:
        one.step_wall_clock(0)
    scene.ended("wall clock step", began, recovery, RECOVERY_SECONDS_MAX, note=f"{seconds:+.0f} s at {len(victims)}")


async def exhaust_descriptors(scene: Scene) -> None:
    """A supernode may open three files more, and many callers connect to it."""
    victim = scene.dice.choice(scene.cluster.supernodes)
    began = time.monotonic()
    victim.limit_descriptors(3)
    connections = [_connect(victim) for _ in range(40)]
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(3.0)
    finally:
        for connection in connections:
            connection.close()
        if victim.running:
            victim.limit_descriptors(None)
    died = not victim.running
    if died:
        await victim.start()
    fresh = await asyncio.to_thread(_answers, victim)
    note = f"{victim.name} {'ended and was started again' if died else 'went on'}; new connections: {fresh}"
    scene.ended("file descriptors exhausted", began, recovery, RECOVERY_SECONDS_MAX, note=note)


def _connect(one: Supernode) -> socket.socket:
    connection = socket.socket()
    connection.setblocking(False)
    connection.connect_ex((one.place.address, PORT))
    return connection


def _answers(one: Supernode) -> str:
    """Whether a new connection gets HTTP/2 settings; the listener must have survived."""
    with socket.create_connection((one.place.address, PORT), timeout=10) as connection:
        connection.settimeout(10)
        connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0)))
        return "served" if connection.recv(9) else "closed at once"


class _Trap:
    """Unpickled, it leaves a file behind."""

    def __init__(self, canary: Path) -> None:
        self._canary = canary

    def __reduce__(self) -> tuple[object, tuple[list[str]]]:
        return subprocess.check_call, (["touch", str(self._canary)],)


async def garbage(scene: Scene) -> None:
    """Random bytes and pickles on every port, raw and as messages of every streaming and unary method of Raft."""
    began = time.monotonic()
    canary = scene.folder / "canary"
    trap = pickle.dumps(_Trap(canary))
    for one in scene.cluster.supernodes:
        await asyncio.to_thread(
            _send_raw, one, [trap, *(scene.dice.randbytes(3000) for _ in range(GARBAGE_CONNECTIONS))]
        )
        for payload in (trap, scene.dice.randbytes(2000)):
            await _send_as_messages(one, payload)
    recovery = await scene.recovery(began)
    if canary.exists():
        raise AssertionError("a pickle that came from the network was loaded")
    if not all(one.running for one in scene.cluster.supernodes):
        raise AssertionError("a supernode ended because of what came from the network")
    scene.ended("random bytes and pickles on every port", began, recovery, RECOVERY_SECONDS_MAX)


def _send_raw(one: Supernode, payloads: list[bytes]) -> None:
    preface = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
    for payload in payloads:
        for data in (payload, preface + payload):
            connection = socket.create_connection((one.place.address, PORT), timeout=5)
            with connection, contextlib.suppress(OSError):  # it may hang up on us, which is its right
                connection.sendall(data)


async def _send_as_messages(one: Supernode, payload: bytes) -> None:
    from stampede_rt.v1 import directory_service_pb2, membership_service_pb2, raft_service_pb2

    for module in (directory_service_pb2, membership_service_pb2, raft_service_pb2):
        for service in module.DESCRIPTOR.services_by_name.values():
            for method in service.methods:
                path = f"/{service.full_name}/{method.name}"
                call = one.channel.stream_stream(path)(iter([payload]), timeout=0.3)
                try:
                    async for _ in call:
                        pass
                except grpc.aio.AioRpcError:
                    pass  # any refusal will do; what counts is checked by the caller


EVERY_FAULT: dict[str, Fault] = {
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
    "full_disk": full_disk,
    "flip_bit": flip_bit,
    "truncate": truncate,
    "step_clock": step_clock,
    "exhaust_descriptors": exhaust_descriptors,
    "garbage": garbage,
}
