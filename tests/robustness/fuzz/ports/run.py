"""One run against one port: a cluster of its own, hostile callers, and a good client at the same time."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable
from contextlib import suppress

import stampede_rt as st
from stampede_rt.administration.running_cluster import reached
from stampede_rt.v1 import quota_service_pb2
from stampede_rt_runtime.identity import Role
from tests.robustness.fuzz.messages import KnownValues
from tests.robustness.fuzz.ports.cluster import FuzzedCluster, fuzzed_cluster
from tests.robustness.fuzz.ports.command_line import check_commands
from tests.robustness.fuzz.ports.hostile_caller import HostileCaller
from tests.robustness.fuzz.ports.methods import DATA_PORT, methods_of
from tests.robustness.fuzz.ports.outcome import Finding, Outcome
from tests.robustness.fuzz.ports.socket_calls import socket_targets
from tests.robustness.fuzz.ports.target_objects import first_known, keep_targets

GOOD = "good"
# the budget, and the memory that the allocator may keep and gRPC may buffer (docs/security.md)
MEMORY_GROWTH_MIB_MAX = 164
CALLERS = 32
# The roles of the connections to a cluster with certificates.
ROLES = (Role.CLIENT, Role.HOST, Role.OPERATOR, Role.SUPERNODE)
GOOD_SECONDS = 0.1
GOOD_CALL_SECONDS = 20.0
STILL_SECONDS = 15.0


async def run(
    port: str,
    *,
    seed: int,
    inputs: int,
    seconds: float = 3600.0,
    tls: bool = False,
    commands: bool = True,
    report: Callable[[str], None] = lambda _: None,
) -> Outcome:
    """Send `inputs` requests, for at most `seconds`. Calls `report` after each 10,000 requests.

    With `tls` the connections bring certificates of all roles instead of the secret. `commands`: also check the command
    line afterwards, which takes half a minute.
    """
    outcome = Outcome(port, seed)
    async with fuzzed_cluster(outcome, tls=tls) as cluster:
        async with cluster.connect() as rt:
            await rt.channel(GOOD, max_items=100)
            known = await first_known(cluster, GOOD)
            keeping = asyncio.create_task(keep_targets(rt, cluster, known))
            outcome.before_mib = cluster.memory_mib()
            good = asyncio.create_task(_good_client(rt, outcome))
            await _attack(cluster, known, inputs, seconds, report)
            assert not keeping.done(), keeping.exception()
            keeping.cancel()
            _judge_leases(cluster)
            good.cancel()
            await asyncio.wait({good, keeping})
            await _check_serves(cluster)
            if commands:
                await check_commands(cluster.environment(), outcome)
        await _check_memory(cluster)
    return outcome


def _judge_leases(cluster: FuzzedCluster) -> None:
    """Check that leases were lost only while the machine kept the services from a processor."""
    outcome, waits = cluster.outcome, cluster.waits
    outcome.starved_share = waits.most_share
    outcome.excused = sum(waits.starved_at(moment_s) for moment_s in cluster.leases_lost_at)
    if outcome.leases_lost > outcome.excused:
        lost = f"{outcome.leases_lost} leases were lost, {outcome.excused} of them while a service had no processor"
        outcome.add(Finding(what=lost, method="lease"))


async def _attack(
    cluster: FuzzedCluster, known: KnownValues, inputs: int, seconds: float, report: Callable[[str], None]
) -> None:
    outcome, began = cluster.outcome, time.monotonic()
    methods = methods_of(outcome.port)
    channels = [cluster.channel(cluster.target.address, role) for role in ROLES]
    is_host = outcome.port in ("host", DATA_PORT)
    targets = await socket_targets(channels[0], cluster.metadata) if is_host else []
    sockets = [cluster.socket(targets, role) for role in ROLES]

    async def calls(number: int) -> None:
        caller = HostileCaller(methods, known, cluster.metadata, outcome, seed=f"{outcome.seed}/{number}")
        caller.socket = sockets[number % len(sockets)]
        while outcome.inputs < inputs and time.monotonic() - began < seconds and cluster.target.alive:
            await caller.play(channels[number % len(channels)])
            outcome.seconds = time.monotonic() - began

    watching = asyncio.create_task(_watch_memory(cluster, report))
    with cluster.waits:
        await asyncio.gather(*(calls(number) for number in range(CALLERS)))
    watching.cancel()
    for channel in channels:
        await channel.close(None)


async def _watch_memory(cluster: FuzzedCluster, report: Callable[[str], None]) -> None:
    outcome, next_report = cluster.outcome, 10_000
    while True:
        with suppress(OSError):
            now_mib = cluster.memory_mib()
            outcome.most_mib = max(outcome.most_mib, now_mib)
            if outcome.inputs >= next_report:
                report(f"{outcome.port}: {outcome.inputs:,} inputs, {outcome.seconds:.0f} s, {now_mib:.1f} MiB")
                next_report += 10_000
        await asyncio.sleep(0.25)


async def _good_client(rt: st.aio.Connection, outcome: Outcome) -> None:
    """Puts and reads, slowly."""
    channel = await rt.channel(GOOD, max_items=100)
    while True:
        outcome.good_calls += 2
        try:
            await channel.put(b"good", timeout=GOOD_CALL_SECONDS)
            await channel.newest(timeout=GOOD_CALL_SECONDS)
        except st.StampedeError as error:
            outcome.good_failures.append(repr(error))
        await asyncio.sleep(GOOD_SECONDS)


async def _check_serves(cluster: FuzzedCluster) -> None:
    """Check that a new client can still use the real host. Hostile callers with the secret may register hosts, too.

    The check tries for GOOD_CALL_SECONDS: other work on the machine may keep the services from a processor for longer
    than `connect` waits. First the check removes all quotas, because hostile operators may have set quotas that refuse
    each call.
    """
    await asyncio.to_thread(_remove_quotas, cluster)
    until_s = time.monotonic() + GOOD_CALL_SECONDS
    while (error := await _failure_to_serve(cluster)) is not None and time.monotonic() < until_s:  # noqa: ASYNC110
        await asyncio.sleep(1.0)
    if error is not None:
        cluster.outcome.add(Finding(what=f"a new client is not served: {error!r}", method="afterwards"))


def _remove_quotas(cluster: FuzzedCluster) -> None:
    one = cluster.processes
    tls = one.tls_files("good", Role.OPERATOR)
    with suppress(st.StampedeError), reached(one.address, None, secret=one.secret.text, tls=tls) as operator:
        listed = operator.ask_quotas("ListQuotas", quota_service_pb2.ListQuotasRequest())
        for who in sorted({one.who for one in listed.settings}):
            request = quota_service_pb2.RemoveQuotasRequest(request_id=secrets.token_bytes(16), who=who)
            operator.ask_quotas("RemoveQuotas", request)


async def _failure_to_serve(cluster: FuzzedCluster) -> st.StampedeError | None:
    try:
        async with cluster.connect() as rt:
            channel = await rt.channel("afterwards", max_items=10, host="h1")
            await channel.put(b"x", timeout=GOOD_CALL_SECONDS)
            queue = await rt.queue("afterwards", host="h1")
            await queue.put(b"x", timeout=GOOD_CALL_SECONDS)
    except st.StampedeError as error:
        return error
    return None


async def _check_memory(cluster: FuzzedCluster) -> None:
    """Check the memory once it has not changed for a while."""
    outcome = cluster.outcome
    if not cluster.target.alive:
        return
    last, since, until = cluster.memory_mib(), time.monotonic(), time.monotonic() + STILL_SECONDS
    while time.monotonic() < min(since + 3.0, until):
        await asyncio.sleep(0.25)
        if abs(cluster.memory_mib() - last) > 1.0:
            last, since = cluster.memory_mib(), time.monotonic()
    outcome.after_mib = cluster.memory_mib()
    if outcome.after_mib > outcome.before_mib + MEMORY_GROWTH_MIB_MAX:
        what = f"grew from {outcome.before_mib:.0f} to {outcome.after_mib:.0f} MiB"
        outcome.add(Finding(what=what, method="memory"))
