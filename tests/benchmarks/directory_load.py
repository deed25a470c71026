"""The load that one directory of three supernodes carries: `python -m tests.benchmarks.directory_load`.

Real processes on this machine, with stores on its disk; the clients share its processors with the supernodes. Prints
one table. `--channels` and `--clients` make it smaller.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import os
import secrets
import signal
import statistics
import tempfile
import time
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.v1 import directory_pb2, directory_service_pb2_grpc
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime.dial import dial
from tests.benchmarks.directory_snapshots import snapshots
from tests.support.supernode import processes
from tests.support.supernode.processes import Cluster

WRITERS = 64
READERS = 64
CLIENT_PROCESSES = os.cpu_count() or 1  # more processes would wait for a processor
RECONNECTIONS = 5
SAMPLE_SECONDS = 5.0
CALL_SECONDS = 20.0
MISSED_ENTRIES = 12_000  # more than twice the entries between two snapshots
START_SECONDS_MAX = 180.0
FAN_OUT_SECONDS_MAX = 120.0
# Each client has its own connection, as if it were a separate process. By default the clients would share one.
OWN_CONNECTION = (("grpc.use_local_subchannel_pool", 1),)

Stub = Any
Row = tuple[str, str]


def percentile(seconds: list[float], share: float) -> str:
    ordered = sorted(seconds)
    return f"{ordered[min(len(ordered) - 1, int(share * len(ordered)))] * 1e3:.1f} ms"


async def rate_of(work: Callable[[int], Awaitable[Any]], *, workers: int, seconds: float) -> tuple[float, list[float]]:
    """How often per second all workers together do `work`, and how long each call of `work` took."""
    took: list[float] = []
    until = time.monotonic() + seconds

    async def worker(number: int) -> None:
        while (began := time.monotonic()) < until:
            await work(number)
            took.append(time.monotonic() - began)

    began = time.monotonic()
    await asyncio.gather(*(worker(number) for number in range(workers)))
    return len(took) / (time.monotonic() - began), took


async def open_channel(stub: Stub, name: str) -> None:
    request = pb.OpenChannelRequest(request_id=secrets.token_bytes(16), name=name, create=True)
    await stub.OpenChannel(request, timeout=CALL_SECONDS)


async def register_host(stub: Stub) -> None:
    request = pb.RegisterHostRequest(
        request_id=secrets.token_bytes(16),
        host_id=bytes(16),
        name="host",
        gatekeepers=[directory_pb2.Endpoint(target="localhost:1")],
        boot_incarnation=1,
    )
    await stub.RegisterHost(request, timeout=CALL_SECONDS)


async def writes(stubs: list[Stub], prefix: str, *, workers: int) -> list[Row]:
    names = iter(range(10**9))
    rate, took = await rate_of(
        lambda number: open_channel(stubs[number % len(stubs)], f"{prefix}/{next(names)}"),
        workers=workers,
        seconds=SAMPLE_SECONDS,
    )
    text = f"{rate:,.0f}/s, p50 {percentile(took, 0.5)}, p99 {percentile(took, 0.99)}"
    return [(f"durable writes, {workers} at the same time", text)]


async def lookups(stub: Stub) -> list[Row]:
    rows = []
    for stale_ok in (False, True):
        request = pb.ResolveChannelRequest(name="many/0", stale_ok=stale_ok)
        rate, took = await rate_of(
            lambda _, request=request: stub.ResolveChannel(request, timeout=CALL_SECONDS),  # type: ignore[misc]
            workers=READERS,
            seconds=SAMPLE_SECONDS,
        )
        kind = "stale_ok" if stale_ok else "linearizable"
        rows.append((f"lookups at one supernode, {kind}", f"{rate:,.0f}/s, p99 {percentile(took, 0.99)}"))
    return rows


async def fill(stubs: list[Stub], prefix: str, count: int) -> list[Row]:
    numbers = iter(range(count))
    longest = 0.0

    async def worker(stub: Stub) -> None:
        nonlocal longest
        for number in numbers:
            began = time.monotonic()
            await open_channel(stub, f"{prefix}/{number}")
            longest = max(longest, time.monotonic() - began)

    began = time.monotonic()
    await asyncio.gather(*(worker(stubs[number % len(stubs)]) for number in range(2 * WRITERS)))
    took = time.monotonic() - began
    return [
        (f"{count:,} channels opened", f"{took:.0f} s, {count / took:,.0f}/s"),
        ("... longest write meanwhile, snapshots included", f"{longest * 1e3:.0f} ms"),
    ]


async def fan_out(cluster: Cluster, stub: Stub, clients: int) -> list[Row]:
    """The time from a write to the last of many watches, each on its own stream."""
    addresses = [one.address for one in cluster.supernodes]
    channels = [dial(addresses[number % len(addresses)], secret=None) for number in range(30)]
    index = (await stub.ResolveChannel(pb.ResolveChannelRequest(name="many/0"), timeout=CALL_SECONDS)).applied_index
    arrived: list[float] = []
    ready = [asyncio.Event() for _ in range(clients)]

    async def watch(number: int) -> None:
        call = directory_service_pb2_grpc.DirectoryServiceStub(channels[number % len(channels)]).Watch(
            pb.WatchRequest(name_glob="watched/*", after_index=index)
        )
        async for response in call:
            ready[number].set()
            if response.changes:
                arrived.append(time.monotonic())
                return

    tasks = [asyncio.create_task(watch(number)) for number in range(clients)]
    async with asyncio.timeout(FAN_OUT_SECONDS_MAX):
        await asyncio.gather(*(one.wait() for one in ready))
        began = time.monotonic()
        await open_channel(stub, "watched/one")
        await asyncio.gather(*tasks)
    for channel in channels:
        await channel.close()
    spread = [one - began for one in arrived]
    text = f"first {percentile(spread, 0.0)}, p50 {percentile(spread, 0.5)}, last {percentile(spread, 1.0)}"
    return [(f"a change seen by {clients:,} watches", text)]


async def reconnect(cluster: Cluster, clients: int) -> list[Row]:
    """All clients together, several times: each opens a connection, and makes one confirmed lookup."""
    with ProcessPoolExecutor(CLIENT_PROCESSES, multiprocessing.get_context("spawn")) as processes:
        runs = [await measure_reconnections(cluster, clients, processes) for _ in range(RECONNECTIONS + 1)]
    took, supernode_seconds, client_seconds = zip(
        *runs[1:], strict=True
    )  # without the first run, which imports the modules
    halves = [statistics.median(run) for run in took]
    return [
        (f"{len(took[0]):,} clients connect at the same time and look up", f"half of them {spread(halves)}"),
        ("... the last of them", spread([max(run) for run in took])),
        ("... CPU of the supernodes", spread(supernode_seconds)),
        ("... CPU of the clients", spread(client_seconds)),
    ]


async def measure_reconnections(
    cluster: Cluster, clients: int, processes: ProcessPoolExecutor
) -> tuple[list[float], float, float]:
    """The wait of each client, and the CPU time of the supernodes and of the clients meanwhile."""
    addresses, share = [supernode.address for supernode in cluster.supernodes], -(-clients // CLIENT_PROCESSES)
    loop, at, before = asyncio.get_running_loop(), time.monotonic() + 0.5, cpu_seconds(cluster)
    loads = [loop.run_in_executor(processes, connect_clients, addresses, share, at) for _ in range(CLIENT_PROCESSES)]
    parts = await asyncio.gather(*loads)
    took = [seconds for part, _ in parts for seconds in part]
    return took, cpu_seconds(cluster) - before, sum(cpu for _, cpu in parts)


def spread(seconds: Sequence[float]) -> str:
    return f"{statistics.median(seconds):.2f} s ({min(seconds):.2f} to {max(seconds):.2f})"


def cpu_seconds(cluster: Cluster) -> float:
    """The CPU time of the supernodes since their start."""
    return sum(one.cpu_seconds() for one in cluster.supernodes)


def connect_clients(addresses: list[str], clients: int, at: float) -> tuple[list[float], float]:
    """The time from `at` (this machine's monotonic clock) to the answer of each of these clients, and the CPU time
    of the clients.
    """

    async def one(channel: grpc.aio.Channel) -> float:
        stub = directory_service_pb2_grpc.DirectoryServiceStub(channel)
        await stub.ResolveChannel(pb.ResolveChannelRequest(name="many/0"), timeout=60.0)
        return time.monotonic() - at

    async def all_of_them() -> tuple[list[float], float]:
        await asyncio.sleep(max(0.0, at - time.monotonic()))
        cpu = time.process_time()
        channels = [
            grpc.aio.insecure_channel(addresses[number % len(addresses)], options=OWN_CONNECTION)
            for number in range(clients)
        ]
        took = await asyncio.gather(*map(one, channels))
        cpu = time.process_time() - cpu
        for channel in channels:
            await channel.close()
        return took, cpu

    return asyncio.run(all_of_them())


async def restart(cluster: Cluster) -> list[Row]:
    leader = await cluster.leader()
    follower = next(one for one in cluster.supernodes if one is not leader)
    await follower.end(signal.SIGKILL)
    began = time.monotonic()
    await follower.start()
    ready_s, cpu = time.monotonic() - began, follower.cpu_seconds()
    for each in cluster.supernodes:
        await each.end(signal.SIGKILL)
    began = time.monotonic()
    await cluster.start()
    request = pb.ResolveChannelRequest(name="many/0")
    while True:
        try:
            await cluster.supernodes[0].stub.ResolveChannel(request, timeout=CALL_SECONDS, wait_for_ready=True)
        except grpc.aio.AioRpcError:
            continue
        break
    lookup_s = time.monotonic() - began
    return [
        ("kill -9 of a follower to its ready line", f"{ready_s:.1f} s, {cpu:.2f} s of CPU"),
        ("kill -9 of all to the first confirmed lookup", f"{lookup_s:.1f} s"),
    ]


async def catch_up(cluster: Cluster) -> list[Row]:
    """A follower is unreachable until the log no longer has the entries that it lacks. It then gets a snapshot."""
    leader = await cluster.leader()
    follower, other = cluster.others(leader)
    await follower.end(signal.SIGKILL)
    await fill([leader.stub, other.stub], "missed", MISSED_ENTRIES)
    goal = (await leader.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=CALL_SECONDS)).applied_index
    await follower.start()
    began, reached, slowest = time.monotonic(), 0, 0.0
    while reached < goal:
        asked_s = time.monotonic()
        answer = await follower.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=CALL_SECONDS)
        slowest, reached = max(slowest, time.monotonic() - asked_s), answer.applied_index
        await asyncio.sleep(0.002)
    text = f"{time.monotonic() - began:.1f} s from its ready line, slowest answer meanwhile {slowest * 1e3:.0f} ms"
    return [(f"a follower {MISSED_ENTRIES:,} entries behind gets a snapshot", text)]


def show(rows: list[Row]) -> None:
    for name, text in rows:
        print(f"{name:<50}  {text}", flush=True)


async def measure(channels: int, clients: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        cluster = Cluster(Path(folder), "--lease-ttl", "1h")
        await cluster.start()
        try:
            leader = await cluster.leader()
            stubs = [one.stub for one in cluster.supernodes]
            await register_host(leader.stub)
            show(await writes(stubs, "one", workers=1))
            show(await writes(stubs, "some", workers=WRITERS))
            show(await fill(stubs, "many", channels))
            show(await lookups(leader.stub))
            show(await fan_out(cluster, leader.stub, clients))
            show(await reconnect(cluster, clients))
            show(await catch_up(cluster))
            show(await restart(cluster))
        finally:
            await cluster.close()
        show(await in_a_process(snapshots, Path(folder) / "alone", channels))


async def in_a_process(measure: Callable[..., list[Row]], *arguments: Any) -> list[Row]:
    """The result of `measure` in a separate process without other work."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:
        return await asyncio.get_running_loop().run_in_executor(processes, measure, *arguments)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--channels", type=int, default=100_000)
    parser.add_argument("--clients", type=int, default=1000)
    arguments = parser.parse_args()
    processes.PATIENCE_SECONDS = START_SECONDS_MAX
    asyncio.run(measure(arguments.channels, arguments.clients))


if __name__ == "__main__":
    main()
