"""Clients that attack a host or supernode, and clients that use up a quota, while good clients use the same cluster.

The attacks come from `tests.benchmarks.attacks`. Each attacker is a process in a namespace of its own.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import statistics
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import stampede_rt as st
from stampede_rt.administration.running_cluster import PartUse, reached
from stampede_rt.v1 import quota_pb2, quota_service_pb2
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.quotas.messages import KINDS, quota_from
from tests.benchmarks.attacks.attacked_cluster import GOOD_CHANNEL, NAME_VARIABLE, AttackedCluster
from tests.benchmarks.attacks.attacker import UNDER_WAY
from tests.benchmarks.attacks.catalogue import CASES
from tests.robustness.faults.scene import RECOVERY_SECONDS_MAX, Fault, Scene
from tests.robustness.fuzz.ports.run import MEMORY_GROWTH_MIB_MAX
from tests.robustness.processor_waits import ProcessorWaits
from tests.robustness.real_cluster.cluster import request_id
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect, PlacedProcess
from tests.support.supernode.processes import clean_environment

BESIDE_CHANNELS_MIB_MAX = MEMORY_GROWTH_MIB_MAX - 64
"""The most by which the memory of a host may grow, in addition to its channels and queues. The budget for these is 64
MiB. A host that kept 1 MiB for each of 60 streams exceeded this limit."""
ATTACK_SECONDS, UNDER_WAY_SECONDS, END_SECONDS, FREE_SECONDS_MAX = 4.0, 120.0, 10.0, 20.0
GOOD_ITEMS_MAX = 50_000
PERIOD_SECONDS, CALL_SECONDS = 0.02, 10.0
ATTACKER = "attacker"
LEASE_LOST = "the lease has ended"
TOKEN_NANOS = 3600 * 10**9
MIB = 2**20
# For each quota: an attack that uses it up, and a low limit. Beyond the limit of `cpu-percent` the service delays
# calls, and refuses none.
QUOTAS: dict[Quota, tuple[str, int]] = {
    Quota.STREAMS: ("many-streams", 100),
    Quota.SUBSCRIPTIONS: ("many-subscriptions", 100),
    Quota.WAITING_CALLS: ("blocked-gets", 100),
    Quota.BYTES_IN_FLIGHT: ("waiting-puts", 4 * MIB),
    Quota.CHANNELS: ("new-channels", 20),
    Quota.QUEUES: ("new-queues", 3),
    Quota.GROUPS: ("new-groups", 1),
    Quota.PEERS: ("new-peers", 5),
    Quota.CHANGES_PER_SECOND: ("new-channels", 1),
    Quota.BYTES_HELD: ("held-bytes", 4 * MIB),
    Quota.BYTES_ARCHIVED: ("archived-bytes", 4 * MIB),
    Quota.CPU_PERCENT: ("busy-puts", 10),
}
_numbers = itertools.count(1)


@dataclass
class Puts:
    """The puts of a good client during an attack: the time that each took, and the seqs of the acknowledged ones."""

    channel: Any
    took_ms: list[float] = field(default_factory=list)
    acked: set[int] = field(default_factory=set)

    async def run(self) -> None:
        """Put until cancelled. Raises StampedeError: no put of a good client may fail."""
        while True:
            began = time.perf_counter()
            self.acked.add((await self.channel.put(b"x" * 100, timeout=CALL_SECONDS)).seq)
            self.took_ms.append((time.perf_counter() - began) * 1000)
            await asyncio.sleep(PERIOD_SECONDS)

    async def check_kept(self) -> None:
        """Raises AssertionError if an acknowledged item is not there."""
        wanted = {"newest_first": True, "limit": len(self.acked) + 10, "payloads": False, "timeout": CALL_SECONDS}
        items = await self.channel.get(st.OLDEST, st.NEWEST, **wanted)
        if lost := self.acked - {item.seq for item in items}:
            raise AssertionError(f"{len(lost)} acknowledged items are lost, among them seq {min(lost)}")

    def __str__(self) -> str:
        cuts = statistics.quantiles(self.took_ms, n=100, method="inclusive")
        return f"{len(self.took_ms)} good puts, p50 {cuts[49]:.1f} ms, p99 {cuts[98]:.1f} ms"


async def attack(scene: Scene, name: str, quota: Quota | None = None) -> None:
    """Run the attack of that name for a while. With `quota`, set a low limit, and check that the attacker reaches it.

    Raises FaultHadNoEffect, StampedeError for a failed good put, TimeoutError if the process does not free its memory,
    and AssertionError if a host lost its lease or an acknowledged item.
    """
    watched: PlacedProcess = scene.cluster.hosts[0] if CASES[name].watched == "host" else scene.cluster.supernodes[0]
    assert scene.traffic is not None
    puts = Puts(await scene.traffic.rt.channel(GOOD_CHANNEL, max_items=GOOD_ITEMS_MAX))
    leases, thing, began = _leases_lost(scene), f"hostile-{next(_numbers)}", time.monotonic()
    calm_bytes = scene.calm_bytes.setdefault(watched.name, watched.memory_bytes())
    watched.forget_memory_peak()
    with ProcessorWaits(lambda: [one.pid for one in scene.cluster.processes() if one.running]) as waits:
        recovery, evidence = await _attacked(scene, name, quota, thing, watched, puts)
        note = f"{puts}; {watched.name} had {calm_bytes / MIB:.0f} MiB, at most {watched.memory_peak_bytes() / MIB:.0f}"
        await puts.check_kept()
        await _delete_things(scene, thing)
        after = await wait_until_memory_is_freed(watched, calm_bytes, name, partial(_held_bytes, scene, watched))
        if _leases_lost(scene) > leases and not waits.starved_at(began, time.monotonic()):
            raise AssertionError(f"a host lost its lease during the attack {name}")
    note += f", then {after / MIB:.0f}; waited {waits.most_share:.0%} of 2 s for a processor"
    note += "; A LEASE WAS LOST meanwhile" if _leases_lost(scene) > leases else ""
    kind = f"quota {quota} used up by {name}" if quota else f"attack {name}"
    scene.ended(kind, began, recovery, limit_s=RECOVERY_SECONDS_MAX, evidence=evidence, note=note)


async def _attacked(
    scene: Scene, name: str, quota: Quota | None, thing: str, watched: PlacedProcess, puts: Puts
) -> tuple[float, str]:
    """Attack. Returns the recovery time of the directory, and the evidence."""
    began, connections, earlier = time.monotonic(), watched.descriptors(), await asyncio.to_thread(_used, scene)
    async with _limited(scene, quota), _attacking(scene, name, thing):
        good_puts = asyncio.create_task(puts.run())
        try:
            recovery = await scene.recovery(began)
            await asyncio.wait({good_puts}, timeout=ATTACK_SECONDS)
            while len(puts.took_ms) < 2 and not good_puts.done():
                await asyncio.wait({good_puts}, timeout=PERIOD_SECONDS)
            present_connections, used = watched.descriptors(), await asyncio.to_thread(_used, scene)
        finally:
            good_puts.cancel()
            with suppress(asyncio.CancelledError):
                await good_puts
    if quota:
        return recovery, _refusals(earlier, used, quota)
    if present_connections <= connections and not used:
        raise FaultHadNoEffect(f"the attacker of {name} has no connection to {watched.name}, and uses nothing")
    return recovery, f"{present_connections - connections} connections of the attacker"


async def wait_until_memory_is_freed(
    watched: PlacedProcess, calm_bytes: int, name: str, held_bytes: Callable[[], Awaitable[int | None]]
) -> int:
    """Wait until the memory is near `calm_bytes`, the memory before the first attack. Raises TimeoutError.

    `held_bytes`: the bytes of channels and queues, which a host may keep; None: the process is no host.
    """
    until_s = time.monotonic() + FREE_SECONDS_MAX
    while True:
        held, memory_bytes = await held_bytes(), watched.memory_bytes()
        bytes_max = calm_bytes + (MEMORY_GROWTH_MIB_MAX * MIB if held is None else held + BESIDE_CHANNELS_MIB_MAX * MIB)
        if memory_bytes <= bytes_max:
            return memory_bytes
        if time.monotonic() > until_s:
            finding = f"{watched.name} has {memory_bytes / MIB:.0f} MiB after {name}, and had {calm_bytes / MIB:.0f}"
            raise TimeoutError(f"{finding}; its channels and queues hold {(held or 0) / MIB:.0f}")
        await asyncio.sleep(PERIOD_SECONDS)


async def _held_bytes(scene: Scene, watched: PlacedProcess) -> int | None:
    """The bytes of a host's channels and queues, as it last reported to the directory; None: the process is no host."""
    assert scene.traffic is not None
    loads = {one.name: one.load for one in await scene.traffic.rt.hosts()}
    if watched.name not in loads:
        return None
    load = loads[watched.name]
    return 0 if load is None else load.held_bytes


def _leases_lost(scene: Scene) -> int:
    return sum(host.log_file.read_text(errors="replace").count(LEASE_LOST) for host in scene.cluster.hosts)


@asynccontextmanager
async def _attacking(scene: Scene, name: str, thing: str) -> AsyncIterator[None]:
    """Run the attacker during the block, on things whose names begin with `thing`."""
    attacked = await asyncio.to_thread(_attacked_cluster, scene)
    words = (sys.executable, "-m", "tests.benchmarks.attacks.attacker", name)
    process = await asyncio.create_subprocess_exec(
        *scene.cluster.outside.command(*words),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
        env=clean_environment() | {NAME_VARIABLE: thing, "PYTHONPATH": os.getcwd()},
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        process.stdin.write(attacked.to_line().encode() + b"\n")
        line = b""
        with suppress(TimeoutError):
            async with asyncio.timeout(UNDER_WAY_SECONDS):
                line = await process.stdout.readline()
        if line.decode().strip() != UNDER_WAY:
            raise FaultHadNoEffect(f"the attacker of {name} failed, or was not ready after {UNDER_WAY_SECONDS:g} s")
        yield
        if process.returncode is not None:
            raise FaultHadNoEffect(f"the attacker of {name} ended by itself")
    finally:
        process.stdin.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(END_SECONDS):
                await process.wait()
        if process.returncode is None:
            process.kill()
            await process.wait()


def _attacked_cluster(scene: Scene) -> AttackedCluster:
    cluster = scene.cluster
    assert cluster.frontend is not None
    with reached(cluster.frontend.address, None) as operator:
        token = operator.issue_client_token(ATTACKER, ["client"], valid_nanos=TOKEN_NANOS).token
    return AttackedCluster(
        frontend=cluster.frontend.address,
        supernode=cluster.supernodes[0].address,
        host=cluster.hosts[0].address,
        data_port=cluster.hosts[0].data_address,
        secret=token,
    )


@asynccontextmanager
async def _limited(scene: Scene, quota: Quota | None) -> AsyncIterator[None]:
    """Set a low limit of that quota for the attacker during the block."""
    if quota is None:
        yield
        return
    setting = quota_pb2.QuotaSetting(who=ATTACKER, kind=KINDS[quota], limit=QUOTAS[quota][1])
    set_limit = quota_service_pb2.SetQuotasRequest(request_id=request_id(), settings=[setting])
    await asyncio.to_thread(_ask, scene, "SetQuotas", set_limit)
    try:
        yield
    finally:
        remove_limit = quota_service_pb2.RemoveQuotasRequest(request_id=request_id(), who=ATTACKER)
        await asyncio.to_thread(_ask, scene, "RemoveQuotas", remove_limit)


def _ask(scene: Scene, rpc: str, request: Any) -> None:
    assert scene.cluster.frontend is not None
    with reached(scene.cluster.frontend.address, None) as operator:
        operator.ask_quotas(rpc, request)


def _used(scene: Scene) -> list[PartUse]:
    """The attacker's use and refusals at each part of the cluster."""
    assert scene.cluster.frontend is not None
    with reached(scene.cluster.frontend.address, None) as operator:
        return [part for who in (ATTACKER, f"@{scene.cluster.outside.address}") for part in operator.quota_uses(who)]


def _refusals(earlier: list[PartUse], later: list[PartUse], quota: Quota) -> str:
    """The evidence that the attacker reached its limit. Raises FaultHadNoEffect without evidence."""
    before = {part: use.refused for part, use in _uses(earlier, quota)}
    for part, use in _uses(later, quota):
        refused = use.refused - before.get(part, 0)
        if refused or (quota is Quota.CPU_PERCENT and use.used):
            return f"{part}: {use.used} of {use.limit} used, {refused} refused"
    raise FaultHadNoEffect(f"the quota {quota} has refused no call")


def _uses(parts: list[PartUse], quota: Quota) -> Iterator[tuple[str, quota_pb2.QuotaUse]]:
    yield from ((part.part, use) for part in parts for use in part.uses if quota_from(use.kind) is quota)


async def _delete_things(scene: Scene, thing: str) -> None:
    """Delete the large things that the attacker has made."""
    assert scene.traffic is not None
    rt = scene.traffic.rt
    handles = [partial(rt.group, thing), partial(rt.queue, thing, create=False)]
    handles += [partial(rt.channel, name, create=False) for name in (thing, f"{thing}/left", f"{thing}/right")]
    for handle in handles:
        with suppress(st.ChannelNotFound, st.QueueNotFound, st.GroupNotFound):
            await (await handle()).delete()


FAULTS: dict[str, Fault] = {
    **{f"attack_{name}": partial(attack, name=name) for name, case in CASES.items() if not case.secured},
    **{f"quota_{quota}": partial(attack, name=name, quota=quota) for quota, (name, _) in QUOTAS.items()},
}
