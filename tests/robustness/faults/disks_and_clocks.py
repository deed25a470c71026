"""Faults of machines: full or damaged disks, clocks that step, and file descriptors that run out."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import socket
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tests.robustness.faults.scene import RECOVERY_SECONDS_MAX, Fault, Scene
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect, PlacedProcess
from tests.robustness.real_cluster.supernode import Supernode

HOUR, DAY = 3600.0, 86400.0
CLOCK_TOLERANCE_SECONDS = 5.0


async def full_disk(scene: Scene) -> None:
    """Fill the disk of one supernode, a small tmpfs, for a while."""
    victim = next(one for one in scene.cluster.supernodes if one.has_small_disk)
    began = time.monotonic()
    ballast = victim.data_dir / "ballast"
    with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):  # the disk is full now, as wanted
        while file.write(b"\0" * 4096):
            pass
    free = os.statvfs(victim.data_dir).f_bavail
    if free:
        raise FaultHadNoEffect(f"the disk of {victim.name} has {free} blocks left")
    recovery = await scene.recovery(began)
    for _ in range(30):  # the write-ahead log still has some room, so write enough to need more
        if not victim.running:
            break
        await asyncio.gather(*(scene.probe.write(scene.cluster.supernodes[0]) for _ in range(50)))
    died = await _has_ended(victim, within_s=3.0)
    ballast.unlink()
    if died:
        await victim.start()
    note = f"it ended ({victim.last_log_line()[:120]!r}) and was started again" if died else "it went on"
    scene.ended("full disk", began, recovery, evidence="the disk had no free block", note=note)


async def _has_ended(one: Supernode, *, within_s: float) -> bool:
    """Whether the process ends within that time. It needs a moment for its last log lines."""
    try:
        async with asyncio.timeout(within_s):
            await one.ended()
    except TimeoutError:
        return False
    return True


async def _damage(scene: Scene, kind: str, harm: Callable[[Path], str]) -> None:
    """Kill a supernode, damage a file of its store, and start it.

    The supernode must refuse the store, or serve only right data.
    """
    _, victim, _ = await scene.leader_and_other()
    began = time.monotonic()
    await victim.kill()
    with tempfile.TemporaryDirectory(dir=scene.folder) as folder:
        spare = Path(shutil.copytree(victim.data_dir, Path(folder, "spare")))
        note = await _damaged(scene, victim, spare, harm)
    scene.ended(kind, began, await scene.recovery(began), evidence="the file differs from its copy", note=note)


async def _damaged(scene: Scene, victim: Supernode, spare: Path, harm: Callable[[Path], str]) -> str:
    """Damage a file, and start the supernode with it. Returns a text about the result.

    If the supernode refused the store, the store is as in `spare` afterwards.
    """
    files = [file for file in sorted(victim.data_dir.rglob("*")) if file.is_file() and file.stat().st_size > 0]
    # In half of the cases choose the largest file, which holds the log. Otherwise choose any file, because small files
    # must be damaged, too.
    chosen = scene.rng.choice([max(files, key=lambda file: file.stat().st_size), scene.rng.choice(files)])
    what = harm(chosen)
    if chosen.read_bytes() == (spare / chosen.relative_to(victim.data_dir)).read_bytes():
        raise FaultHadNoEffect(f"{chosen.name} is as it was")
    started = await victim.start()
    note = f"{what}: " + ("harmless, it serves" if started else f"refused: {victim.last_log_line()[:160]!r}")
    await asyncio.sleep(2.0)  # if it serves wrong data, callers see them within this time
    if not started or not victim.running:
        await victim.end()
        for file in victim.data_dir.iterdir():
            file.unlink() if file.is_file() else shutil.rmtree(file)
        shutil.copytree(spare, victim.data_dir, dirs_exist_ok=True)
        await victim.start()
    return note


async def flip_bit(scene: Scene) -> None:
    def harm(file: Path) -> str:
        data = bytearray(file.read_bytes())
        position = scene.rng.randrange(len(data))
        data[position] ^= 1 << scene.rng.randrange(8)
        file.write_bytes(data)
        return f"{file.name}, byte {position} of {len(data)}"

    await _damage(scene, "flipped bit in a store file", harm)


async def truncate(scene: Scene) -> None:
    def harm(file: Path) -> str:
        size = file.stat().st_size
        left = scene.rng.randrange(size)
        os.truncate(file, left)
        return f"{file.name}, {left} of {size} bytes left"

    await _damage(scene, "truncated store file", harm)


async def step_clock(scene: Scene) -> None:
    """Step the clock of the leader, or of all services. Certificates, if there are any, stay valid."""
    secured = scene.cluster.certificates is not None
    seconds = scene.rng.choice([-120.0, HOUR, 30 * DAY] if secured else [-HOUR, HOUR, -3650 * DAY, 3650 * DAY])
    leader = await scene.cluster.leader()
    victims: Sequence[PlacedProcess] = scene.rng.choice([scene.cluster.processes(), [leader]])
    began = time.monotonic()
    for one in victims:
        one.step_wall_clock(seconds)
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(3.0)
        seen = await leader.wall_clock_nanos() / 1e9 - time.time()
        if abs(seen - seconds) > CLOCK_TOLERANCE_SECONDS:
            raise FaultHadNoEffect(f"{leader.name} says that its clock is off by {seen:+.0f} s, not {seconds:+.0f} s")
        recovery = max(recovery, await scene.recovery(time.monotonic()))
    finally:
        for one in victims:
            one.step_wall_clock(0)
    evidence = f"the leader's answers were off by {seen:+.0f} s"
    note = f"{seconds:+.0f} s at {len(victims)} of {len(scene.cluster.processes())} processes"
    scene.ended("wall clock step", began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence, note=note)


async def exhaust_descriptors(scene: Scene) -> None:
    """Let a service open only three more files, while many callers connect to it."""
    victim = scene.rng.choice(scene.cluster.processes())
    began = time.monotonic()
    limit = victim.limit_descriptors(3)
    connections = [_connect(victim) for _ in range(40)]
    try:
        recovery = await scene.recovery(began)
        await asyncio.sleep(3.0)
        most = victim.descriptors() if victim.running else limit
    finally:
        for connection in connections:
            connection.close()
        if victim.running:
            victim.limit_descriptors(None)
    if most < limit:
        raise FaultHadNoEffect(f"{victim.name} had {most} of {limit} descriptors open with 40 callers waiting")
    died = not victim.running
    if died:
        await victim.start()
    fresh = await asyncio.to_thread(_answers, victim)
    note = f"{victim.name} {'ended and was started again' if died else 'went on'}; new connections: {fresh}"
    evidence = f"all {limit} descriptors were open"
    scene.ended(
        "file descriptors exhausted", began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence, note=note
    )


def _connect(one: PlacedProcess) -> socket.socket:
    connection = socket.socket()
    connection.setblocking(False)
    connection.connect_ex((one.namespace.address, one.port))
    return connection


def _answers(one: PlacedProcess) -> str:
    """Connect to the service. Returns a text that says whether the service serves the new connection."""
    with socket.create_connection((one.namespace.address, one.port), timeout=10) as connection:
        connection.settimeout(1.0)
        if one.tls is None:
            connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0)))
        try:
            return "served" if connection.recv(9) else "closed immediately"
        except TimeoutError:  # a service with certificates waits for the caller's hello
            return "served" if one.tls is not None else "not answered"


FAULTS: dict[str, Fault] = {
    "full_disk": full_disk,
    "flip_bit": flip_bit,
    "truncate": truncate,
    "exhaust_descriptors": exhaust_descriptors,
    "step_clock": step_clock,
}
