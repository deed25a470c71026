"""Disks that are full or damaged, clocks that step, descriptors that run out, noise on every port."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import shutil
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.v1 import directory_service_pb2, membership_service_pb2, raft_service_pb2
from tests.robustness.cluster import PORT, Supernode
from tests.robustness.scene import RECOVERY_SECONDS_MAX, Fault, Scene

GARBAGE_CONNECTIONS = 12


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
    for module in (directory_service_pb2, membership_service_pb2, raft_service_pb2):
        for service in module.DESCRIPTOR.services_by_name.values():
            for method in service.methods:
                path = f"/{service.full_name}/{method.name}"
                call: Any = one.channel.stream_stream(path)(iter([payload]), timeout=0.3)  # type: ignore[arg-type]
                try:
                    async for _ in call:
                        pass
                except grpc.aio.AioRpcError:
                    pass  # any refusal will do; what counts is checked by the caller


FAULTS: dict[str, Fault] = {
    "full_disk": full_disk,
    "flip_bit": flip_bit,
    "truncate": truncate,
    "step_clock": step_clock,
    "exhaust_descriptors": exhaust_descriptors,
    "garbage": garbage,
}
