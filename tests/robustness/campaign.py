"""Injects faults one after the other into a cluster that is in use, and then judges the histories of its calls."""

from __future__ import annotations

import asyncio
import itertools
import random
import time
import traceback
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import grpc

from stampede_rt.errors import StampedeError
from tests.robustness.faults import (
    copy_faults,
    disks_and_clocks,
    host_faults,
    hostile_callers,
    kills_and_cuts,
    malformed_traffic,
    membership,
    vanished,
    wrong_certificates,
)
from tests.robustness.faults.scene import Fault, Outcome, Scene
from tests.robustness.histories.channel_model import acknowledged_writes, violations
from tests.robustness.histories.operations import Operation, Recorder
from tests.robustness.histories.ownership_model import Judgement, early_losses, judge_items
from tests.robustness.real_cluster.callers import Caller, HostActor
from tests.robustness.real_cluster.cluster import Cluster, running_cluster
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect
from tests.robustness.real_cluster.probe import ChannelWrites, Probe, Write, register_probe_host, with_background
from tests.robustness.real_cluster.traffic import Traffic

OPEN_FAULTS: dict[str, Fault] = {
    **kills_and_cuts.FAULTS,
    **disks_and_clocks.FAULTS,
    **membership.FAULTS,
    **malformed_traffic.FAULTS,
}
SECURED_FAULTS: dict[str, Fault] = {**OPEN_FAULTS, **wrong_certificates.FAULTS}
# For clusters that compact their logs as rarely as in production. A partition of a campaign ends before such a log is
# compacted, so the fault `past_compaction` would have no effect.
RARELY_COMPACTED_FAULTS = {name: fault for name, fault in OPEN_FAULTS.items() if name != "past_compaction"}
OF_THE_DIRECTORY = ("kill_leader", "kill_all", "freeze_leader", "split_off_leader", "exhaust_descriptors", "step_clock")
HOST_FAULTS: dict[str, Fault] = {
    **host_faults.FAULTS,
    **vanished.FAULTS,
    **malformed_traffic.FAULTS,
    **wrong_certificates.FAULTS,
    **{name: fault for name, fault in OPEN_FAULTS.items() if name in OF_THE_DIRECTORY},
}
HOSTILE_FAULTS: dict[str, Fault] = hostile_callers.FAULTS
COPY_FAULTS: dict[str, Fault] = {
    **copy_faults.FAULTS,
    **{
        name: fault
        for name, fault in OPEN_FAULTS.items()
        if name in ("kill_leader", "freeze_leader", "split_off_leader")
    },
}
EVERY_FAULT: dict[str, Fault] = {**SECURED_FAULTS, **HOST_FAULTS, **HOSTILE_FAULTS, **COPY_FAULTS}
REPLICATED = {"replicas": 1, "ack": "replica"}
LAGGING = {"replicas": 1, "ack": "host"}
EMPTY: Mapping[str, Any] = MappingProxyType({})
CALLERS, HOST_ACTORS, WORKERS, HOSTS = 6, 3, 4, 3
# (delay, jitter, share of chunks that are retransmitted, share at which the connection is reset)
LINK_CONDITIONS = {
    "delay of 50 to 100 ms": (0.05, 0.05, 0.0, 0.0),
    "delay of 250 to 500 ms": (0.25, 0.25, 0.0, 0.0),
    "1 % loss": (0.002, 0.01, 0.01, 0.0),
    "20 % loss": (0.002, 0.01, 0.2, 0.0),
    "reset connections and delays that overtake": (0.0, 0.3, 0.02, 0.01),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """The results of one campaign, with the judgement of its histories."""

    title: str
    outcomes: list[Outcome]
    operations: list[Operation]
    names: int
    violations: tuple[str, ...]  # histories that no order of the calls explains, and errors that ended the campaign
    items: Judgement | None  # the judgement of the channel hosts, if there were any
    item_calls_failed: int
    not_done: int
    renewals: int
    registrations: int
    gap_s: float  # the longest time without an acknowledged write while a majority was alive and connected
    gap_in: str
    stalled_s: float  # the longest time when this process itself did not run
    seconds: float

    @property
    def acknowledged(self) -> int:
        """The acknowledged writes of the directory."""
        return acknowledged_writes(self.operations)


def in_rounds(names: Iterable[str], seed: int, seconds: float, *, all_once: bool = False) -> Iterator[str]:
    """Yield every fault once, in random order, and then again in other orders until the time is over.

    The first round may take twice the time. On a slow machine it then ends early, so that a campaign has an end. With
    `all_once` the first round is whole in any case.
    """
    rng, known, began = random.Random(seed), sorted(names), time.monotonic()
    for turn in itertools.count():
        for name in rng.sample(known, len(known)):
            if time.monotonic() - began > (seconds if turn else 2 * seconds) and (turn or not all_once):
                return
            yield name


async def run_campaign(
    folder: Path,
    title: str,
    names: Iterable[str],
    *,
    seed: int,
    secured: bool,
    hosts: int = 0,
    compacts_early: bool = True,
    quiet_s: float = 0.5,
    policy: Mapping[str, Any] = EMPTY,
) -> Findings:
    """Inject the named faults in this order. After each fault all processes must serve again. Then wait for `quiet_s`.

    `policy`: the policy of all channels with items. With REPLICATED the loss of a host may lose no acknowledged item,
    and with LAGGING only items of the last second.
    """
    async with running_cluster(
        folder, secured=secured, hosts=hosts, compacts_early=compacts_early, relayed_hosts=bool(policy)
    ) as cluster:
        campaign = _Campaign(cluster, folder, seed, policy)

        async def body() -> None:
            for name in names:
                await campaign.attempt(name, EVERY_FAULT[name])
                await asyncio.sleep(quiet_s)

        return await campaign.run(title, body)


async def run_link_conditions(folder: Path, title: str, *, seed: int, each_s: float) -> Findings:
    """Simulate each kind of bad network, and kill the leader with SIGKILL in the middle of each."""
    async with running_cluster(folder, relayed=True) as cluster:
        campaign = _Campaign(cluster, folder, seed)

        async def body() -> None:
            for kind in LINK_CONDITIONS:
                await campaign.attempt(kind, lambda scene, kind=kind: _under_conditions(scene, kind, each_s))  # type: ignore[misc]

        return await campaign.run(title, body)


async def _under_conditions(scene: Scene, kind: str, each_s: float) -> None:
    """Put one kind of bad network before every supernode. Raises FaultHadNoEffect if no relay applied it."""
    supernodes = scene.cluster.supernodes
    began = time.monotonic()
    relays = [one.relay for one in supernodes if one.relay is not None]
    for relay in relays:
        await relay.set_conditions(*LINK_CONDITIONS[kind])
    await asyncio.sleep(each_s / 2)
    victim = await scene.cluster.leader()
    killed = time.monotonic()
    await victim.kill()
    recovery = await scene.recovery(killed)
    await victim.start()
    await asyncio.sleep(each_s / 2)
    counts = [await relay.set_conditions(0, 0, 0, 0) for relay in relays]
    chunks, stalled, waited_millis, cuts = (sum(column) for column in zip(*counts, strict=True))
    _, _, stall_share, cut_share = LINK_CONDITIONS[kind]
    if not waited_millis or (stall_share and not stalled) or (cut_share and not cuts):
        raise FaultHadNoEffect(
            f"of {chunks} chunks {stalled} were stalled, {waited_millis} ms in all, {cuts} connections cut"
        )
    evidence = f"{chunks} chunks waited {waited_millis / chunks:.0f} ms on average, {stalled} stalled; {cuts} resets"
    scene.ended(f"relay: {kind}, and kill -9 of the leader", began, recovery, majority=False, evidence=evidence)


class _Campaign:
    """The callers, hosts and probe around a cluster, and their findings."""

    def __init__(self, cluster: Cluster, folder: Path, seed: int, policy: Mapping[str, Any] = EMPTY) -> None:
        self._cluster, self._policy = cluster, policy
        self._recorder = Recorder(time.monotonic)
        real = bool(cluster.hosts)
        self._actors = [] if real else [HostActor(number, cluster, seed) for number in range(HOST_ACTORS)]
        self._callers = [Caller(number, cluster, self._recorder, self._actors, seed) for number in range(CALLERS)]
        write: Write = ChannelWrites() if real else register_probe_host
        self._probe = Probe(cluster, write)
        self._traffic = Traffic(cluster, Recorder(time.monotonic), seed, **policy) if real else None
        self._broken: list[str] = []
        self._scene = Scene(cluster, self._probe, random.Random(seed), folder, self._traffic)

    async def attempt(self, name: str, fault: Fault) -> None:
        """Inject one fault.

        If the fault had no effect, or a process did not serve again in time, the fault counts as failed, and the
        campaign goes on. A broken invariant ends the campaign.
        """
        began = time.monotonic()
        try:
            await fault(self._scene)
            for one in self._cluster.processes():
                if not one.running:
                    raise TimeoutError(f"{one.name} has ended: {one.last_log_line()!r}")
            await self._cluster.all_serve()
        except (TimeoutError, OSError, FaultHadNoEffect, StampedeError, grpc.aio.AioRpcError) as error:
            what = "had no effect" if isinstance(error, FaultHadNoEffect) else "did not come back in time"
            self._scene.ended(name, began, majority=False, evidence="-", note=f"{what}: {error}", failed=True)
            await asyncio.gather(*(one.start() for one in self._cluster.processes() if not one.running))
            await self._cluster.all_serve()

    async def run(self, title: str, body: Callable[[], Awaitable[None]]) -> Findings:
        """Run `body` while the callers, hosts and probe run, and then judge the histories."""
        began = time.monotonic()
        try:
            async with self._background(began) as work:
                await with_background(work, body)
        except Exception as error:  # noqa: BLE001 - the findings until then are still judged and shown
            self._broken.append(f"{type(error).__name__}: {error}")
            traceback.print_exc()
        return await asyncio.to_thread(self._judged, title, began)

    @asynccontextmanager
    async def _background(self, began: float) -> AsyncIterator[list[Awaitable[None]]]:
        work: list[Awaitable[None]] = [actor.run() for actor in self._actors]
        work += [caller.run(began) for caller in self._callers]
        work.append(self._probe.run())
        if self._traffic is None:
            yield work
            return
        async with self._traffic as traffic:
            yield [*work, *(traffic.run(began) for _ in range(WORKERS))]

    def _judged(self, title: str, began: float) -> Findings:
        seconds = time.monotonic() - began
        names, wrong = violations(self._recorder.operations)
        items = None if self._traffic is None else judge_items(self._traffic.recorder.operations)
        if self._policy == REPLICATED and items is not None and items.gone_with_host:
            wrong = [*wrong, f"{items.gone_with_host} acknowledged or seen items with replicas went with a host"]
        if self._policy == LAGGING and self._traffic is not None:
            wrong = [*wrong, *early_losses(self._traffic.recorder.operations)]
        gap_s, moment = longest_gap(self._probe.served, self._scene.outcomes)
        around = (one.kind for one in self._scene.outcomes if one.began - 1 <= moment <= one.ended + 1)
        return Findings(
            title=title if self._traffic is None else f"{title}; its clients use {self._traffic.transport!r}",
            outcomes=self._scene.outcomes,
            operations=self._recorder.operations,
            names=names,
            violations=(*self._broken, *wrong, *(items.violations if items is not None else ())),
            items=items,
            item_calls_failed=0 if self._traffic is None else self._traffic.failed,
            not_done=sum(caller.not_done for caller in self._callers),
            renewals=sum(actor.renewals for actor in self._actors),
            registrations=sum(actor.registrations for actor in self._actors),
            gap_s=gap_s,
            gap_in=next(around, "no fault"),
            stalled_s=self._probe.stalled_s(began, began + seconds),
            seconds=seconds,
        )


def longest_gap(served: Sequence[tuple[float, float]], outcomes: Sequence[Outcome]) -> tuple[float, float]:
    """The longest time between two acknowledged writes while a majority could serve, and when it began."""
    times = sorted(answered for _, answered in served)
    without = [(one.began, one.ended) for one in outcomes if not one.majority]
    gaps = [
        (later - earlier, earlier)
        for earlier, later in itertools.pairwise(times)
        if not any(earlier < end and begin < later for begin, end in without)
    ]
    return max(gaps, default=(0.0, 0.0))
