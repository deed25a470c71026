"""One run against one port: a cluster of its own, hostile callers, and a good client beside them."""

from __future__ import annotations

import asyncio
import resource
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.v1 import directory_service_pb2 as directory_pb
from stampede_rt.v1 import group_directory_service_pb2 as group_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queue_pb
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from stampede_rt.v1.group_directory_service_pb2_grpc import GroupDirectoryServiceStub
from stampede_rt.v1.queue_directory_service_pb2_grpc import QueueDirectoryServiceStub
from stampede_rt.version import PROTOCOL_VERSION
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.robustness.fuzz.messages import KnownValues
from tests.robustness.fuzz.ports.hostile_caller import HostileCaller
from tests.robustness.fuzz.ports.methods import methods_of
from tests.robustness.fuzz.ports.outcome import Finding, Outcome

GOOD = "good"
LEASE_LOST = "the lease has ended"
MEMORY_BUDGET = "64MiB"
MEMORY_GROWTH_MIB_MAX = 164  # the budget, and what the allocator may keep and gRPC may buffer (docs/security.md)
CONNECTIONS, CALLERS = 4, 32
GOOD_SECONDS = 0.1
GOOD_CALL_SECONDS = 20.0
STILL_SECONDS = 15.0
MS, S = 10**6, 10**9
NAMES = ("a", "b", "c", "cam/1", "cam/2", "q", "r", "g", "h1", "hostile")
MEMBERS = ("s1", "s9")
TOLD: dict[str, Sequence[Any]] = {
    **dict.fromkeys(("name", "name_glob", "taker_name", "host_name", "mailbox_host_name"), NAMES),
    **dict.fromkeys(("supernode_id", "member_id", "peer_member_id"), MEMBERS),
    **dict.fromkeys(
        ("producer_id", "consumer_id", "taker_id", "call_id", "first_number", "boot_incarnation"), (1, 2, 3)
    ),
    **dict.fromkeys(("wait_nanos", "max_wait_nanos", "delay_nanos"), (0, MS, -1)),
    **dict.fromkeys(("lease_nanos", "valid_nanos"), (S, 10 * S)),
    **dict.fromkeys(("tolerance_nanos", "lateness_nanos"), (0, MS)),
    **dict.fromkeys(("credit", "credit_bytes", "limit", "page_size"), (1, 100, 1000)),
    **dict.fromkeys(("kind", "mode", "match"), (1, 2)),
    **dict.fromkeys(("request_id", "peer_id", "host_id"), tuple(bytes([one]) * 16 for one in range(1, 20))),
    "target": ("localhost:1", "127.0.0.1:2"),
    "proof": (b"p" * 32, b""),
    "epoch": (1, 0),
    "protocol_version": (PROTOCOL_VERSION,),
}
LISTED: tuple[tuple[Any, str, Any], ...] = (
    (DirectoryServiceStub, "ListChannels", directory_pb.ListChannelsRequest(name_glob="?")),
    (DirectoryServiceStub, "ListSupernodes", directory_pb.ListSupernodesRequest()),
    (QueueDirectoryServiceStub, "ListQueues", queue_pb.ListQueuesRequest()),
    (GroupDirectoryServiceStub, "ListGroups", group_pb.ListGroupsRequest()),
)


class FuzzedCluster:
    """One host, one supernode, one front-end, and what they logged."""

    def __init__(self, outcome: Outcome) -> None:
        self.outcome = outcome
        self.processes = LocalCluster(
            hosts=1, supernodes=1, on_line=self._hear, on_exit=self._ended, log_level="warning"
        )
        self.processes.hosts[0].arguments += ["--memory-bytes-max", MEMORY_BUDGET]
        self._stopping = False

    def stop(self) -> None:
        """Everything; ends from here on are wanted."""
        self._stopping = True
        self.processes.stop()

    @property
    def target(self) -> ServiceProcess:
        """The process behind the port."""
        one = self.processes
        return {"host": one.hosts, "supernode": one.supernodes, "frontend": one.frontends}[self.outcome.port][0]

    def memory_mib(self) -> float:
        """Resident now."""
        pages = int(Path(f"/proc/{self.target.pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    def _hear(self, process: ServiceProcess, line: str) -> None:
        if "Traceback" in line or "level=error" in line or LEASE_LOST in line:
            self.outcome.add(Finding(what=f"{process.name} logs: {line[:1500]}", method=line[-120:]))

    def _ended(self, process: ServiceProcess) -> None:
        if not self._stopping:
            last = "\n".join(process.last_lines[-5:])
            self.outcome.add(Finding(what=f"{process.name} ended with {process.exit_code}: {last}", method="a process"))


@asynccontextmanager
async def fuzzed_cluster(outcome: Outcome) -> AsyncIterator[FuzzedCluster]:
    """Running."""
    one = FuzzedCluster(outcome)
    await asyncio.to_thread(one.processes.start)
    try:
        yield one
    finally:
        await asyncio.to_thread(one.stop)


async def run(
    port: str, *, seed: int, inputs: int, seconds: float = 3600.0, told: Callable[[str], None] = lambda _: None
) -> Outcome:
    """Until so many inputs were sent, or for so long at most. `told` hears of each 10,000 inputs."""
    outcome = Outcome(port, seed)
    async with fuzzed_cluster(outcome) as cluster:
        address, secret = cluster.processes.address, cluster.processes.secret.text
        async with st.aio.connect(address, secret=secret) as rt:
            known = await _known(rt, cluster)
            outcome.before_mib = cluster.memory_mib()
            good = asyncio.create_task(_good_client(rt, outcome))
            await _attack(cluster, known, inputs, seconds, told)
            good.cancel()
            await asyncio.wait({good})
            await _check_serves(address, secret, outcome)
        await _check_memory(cluster)
    return outcome


async def _known(rt: st.aio.Connection, cluster: FuzzedCluster) -> KnownValues:
    """What the callers say at first. The good client's channel and the host's identity are nobody else's."""
    known = KnownValues()
    await rt.channel(GOOD, max_items=100)
    known.spare(GOOD, *await _own_ids(cluster))
    channels = [await rt.channel(name, max_items=50) for name in ("a", "b", "c")]
    for channel in channels:
        await channel.put(b"first")
    for name in ("q", "r"):
        await (await rt.queue(name, max_items=50)).put(b"first")
    await rt.group("g", channels)
    for name, values in TOLD.items():
        known.add(name, *values)
    for service, method, request in LISTED:
        known.learn(await _asked(cluster, service, method, request))
    return known


async def _own_ids(cluster: FuzzedCluster) -> list[object]:
    request = directory_pb.ResolveChannelRequest(name=GOOD)
    answer = await _asked(cluster, DirectoryServiceStub, "ResolveChannel", request)
    return [answer.channel.channel_id, answer.host.host_id, answer.host.boot_incarnation]


async def _asked(cluster: FuzzedCluster, service: Any, method: str, request: Any) -> Any:
    async with grpc.aio.insecure_channel(cluster.processes.supernodes[0].address) as channel:
        return await getattr(service(channel), method)(request, metadata=credential(cluster.processes.secret.text))


def credential(secret: str) -> tuple[tuple[str, str], ...]:
    """What lets a caller in."""
    return (("authorization", f"Bearer {secret}"),)


async def _attack(
    cluster: FuzzedCluster, known: KnownValues, inputs: int, seconds: float, told: Callable[[str], None]
) -> None:
    outcome, began = cluster.outcome, time.monotonic()
    methods, metadata = methods_of(outcome.port), credential(cluster.processes.secret.text)
    options = [("grpc.use_local_subchannel_pool", 1), ("grpc.max_receive_message_length", -1)]
    channels = [grpc.aio.insecure_channel(cluster.target.address, options=options) for _ in range(CONNECTIONS)]

    async def calls(number: int) -> None:
        caller = HostileCaller(methods, known, metadata, outcome, seed=f"{outcome.seed}/{number}")
        while outcome.inputs < inputs and time.monotonic() - began < seconds and cluster.target.alive:
            await caller.play(channels[number % CONNECTIONS])
            outcome.seconds = time.monotonic() - began

    watching = asyncio.create_task(_watch_memory(cluster, told))
    await asyncio.gather(*(calls(number) for number in range(CALLERS)))
    watching.cancel()
    for channel in channels:
        await channel.close(None)


async def _watch_memory(cluster: FuzzedCluster, told: Callable[[str], None]) -> None:
    outcome, next_told = cluster.outcome, 10_000
    while True:
        with suppress(OSError):
            now_mib = cluster.memory_mib()
            outcome.most_mib = max(outcome.most_mib, now_mib)
            if outcome.inputs >= next_told:
                told(f"{outcome.port}: {outcome.inputs:,} inputs, {outcome.seconds:.0f} s, {now_mib:.1f} MiB")
                next_told += 10_000
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


async def _check_serves(address: str, secret: str, outcome: Outcome) -> None:
    """Somebody new can still use everything."""
    try:
        async with st.aio.connect(address, secret=secret) as rt:
            channel = await rt.channel("afterwards", max_items=10)
            await channel.put(b"x", timeout=GOOD_CALL_SECONDS)
            queue = await rt.queue("afterwards")
            await queue.put(b"x", timeout=GOOD_CALL_SECONDS)
    except st.StampedeError as error:
        outcome.add(Finding(what=f"nobody new is served: {error!r}", method="afterwards"))


async def _check_memory(cluster: FuzzedCluster) -> None:
    """Once it has not changed for a while."""
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
