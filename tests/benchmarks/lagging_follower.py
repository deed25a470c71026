"""Whether a follower behind a slow link catches up under load: `python -m tests.benchmarks.lagging_follower`.

Three real supernodes run on this machine. The others reach one follower through a relay with a limited rate. The
benchmark kills and restarts this follower while many channels exist and writes go on. It prints how many entries the
follower lacks: before the kill, at the restart, and every few seconds afterwards. The exit code is 1 if the follower
has not caught up in the end.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import secrets
import signal
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.v1 import channel_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from tests.benchmarks.directory_load import CALL_SECONDS, START_SECONDS_MAX, register_host
from tests.support.supernode import processes
from tests.support.supernode.processes import Supernode, free_ports

OPENERS = 128
CAUGHT_UP_ENTRIES = 1000
AWAY_SECONDS = 5.0
LOOK_SECONDS = 5.0


@dataclass
class Load:
    """Changes of channels at a steady rate, until it is cancelled."""

    stubs: list[Any]
    channels: list[Any]
    per_second: float
    done: int = 0
    failed: int = 0
    _under_way: set[asyncio.Task[None]] = field(default_factory=set)

    async def run(self) -> None:
        began, begun = time.monotonic(), 0
        while True:
            due = int((time.monotonic() - began) * self.per_second)
            for number in range(begun, due):
                if len(self._under_way) < OPENERS * 4:
                    task = asyncio.create_task(self._change(number))
                    self._under_way.add(task)
                    task.add_done_callback(self._under_way.discard)
            begun = due
            await asyncio.sleep(0.01)

    async def _change(self, number: int) -> None:
        channel = self.channels[number % len(self.channels)]
        spec = channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=1 + number))
        request = pb.UpdateChannelRequest(
            request_id=secrets.token_bytes(16), channel_id=channel.channel_id, epoch=channel.epoch, spec=spec
        )
        try:
            await self.stubs[number % len(self.stubs)].UpdateChannel(request, timeout=CALL_SECONDS)
            self.done += 1
        except grpc.aio.AioRpcError:
            self.failed += 1


@contextlib.asynccontextmanager
async def narrow_cluster(folder: Path, bytes_per_second: float) -> AsyncIterator[list[Supernode]]:
    """Three supernodes. The others reach the last one through the relay. The last one does not lead."""
    ports = free_ports(4)
    addresses = {f"s{number}": f"127.0.0.1:{port}" for number, port in enumerate(ports[:3], start=1)}
    reached = {**addresses, "s3": f"127.0.0.1:{ports[3]}"}
    members = ",".join(f"{name}={address}" for name, address in reached.items())
    relay = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "tests.robustness.real_cluster.relay", reached["s3"], addresses["s3"]),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    assert relay.stdin is not None
    assert relay.stdout is not None
    supernodes = []
    for name, address in addresses.items():
        arguments = ["--listen", address, "--id", name, "--members", members, "--data-dir", str(folder / name)]
        supernodes.append(Supernode(name, address, [*arguments, "--lease-ttl", "1h"]))
    try:
        await relay.stdout.readline()
        relay.stdin.write(f"0 0 0 0 {bytes_per_second}\n".encode())
        await asyncio.gather(*(one.start() for one in supernodes[:2]))  # a majority, of which one leads before s3 comes
        await leader_of(supernodes[:2])
        await supernodes[2].start()
        yield supernodes
    finally:
        for one in supernodes:
            await one.close()
        relay.kill()
        await relay.wait()


async def leader_of(supernodes: list[Supernode]) -> Supernode:
    """The leader among these supernodes."""
    async for _ in processes.attempts():
        for one in supernodes:
            with contextlib.suppress(grpc.aio.AioRpcError):
                listed = await one.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=1)
                if any(each.supernode_id == one.name and each.is_leader for each in listed.supernodes):
                    return one
    raise AssertionError("unreachable")


async def open_channels(supernodes: list[Supernode], count: int) -> list[Any]:
    """Open `count` channels at one host. Waits for a leader."""
    async for _ in processes.attempts():
        with contextlib.suppress(grpc.aio.AioRpcError):
            await register_host(supernodes[0].stub)
            break
    numbers: Iterator[int] = iter(range(count))
    opened: list[Any] = []

    async def worker(stub: Any) -> None:
        for number in numbers:
            request = pb.OpenChannelRequest(request_id=secrets.token_bytes(16), name=f"many/{number}", create=True)
            opened.append((await stub.OpenChannel(request, timeout=CALL_SECONDS)).channel)

    workers: list[Awaitable[None]] = [worker(supernodes[n % len(supernodes)].stub) for n in range(OPENERS)]
    await asyncio.gather(*workers)
    return opened


async def lag(leader: Supernode, follower: Supernode) -> int:
    """The number of entries that the leader has applied and the follower lacks; 0 or less: none."""
    calls = [one.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=CALL_SECONDS) for one in (follower, leader)]
    behind, ahead = await asyncio.gather(*calls)
    return int(ahead.applied_index - behind.applied_index)


async def measure(channels: int, writes_per_second: float, megabits_per_second: float, seconds: float) -> bool:
    """Whether the follower caught up."""
    with tempfile.TemporaryDirectory(prefix="srt-") as folder:
        async with narrow_cluster(Path(folder), megabits_per_second * 1e6 / 8) as supernodes:
            follower = supernodes[2]
            leader = await leader_of(supernodes[:2])
            opened = await open_channels(supernodes[:2], channels)
            print(f"{len(opened):,} channels", flush=True)
            load = Load([one.stub for one in supernodes[:2]], opened, writes_per_second)
            writing = asyncio.create_task(load.run())
            try:
                return await restart_and_watch(leader, follower, load, seconds)
            finally:
                writing.cancel()
                await asyncio.gather(writing, return_exceptions=True)


async def restart_and_watch(leader: Supernode, follower: Supernode, load: Load, seconds: float) -> bool:
    await wait_until_caught_up(leader, follower)
    await asyncio.sleep(LOOK_SECONDS)
    print(f"before: lacks {await lag(leader, follower):,}", flush=True)
    await follower.end(signal.SIGKILL)
    await asyncio.sleep(AWAY_SECONDS)
    await follower.start()
    began, before, behind = time.monotonic(), load.done, 0
    while (since := time.monotonic() - began) < seconds:
        behind = await lag(leader, follower)
        rate = (load.done - before) / since if since > 1 else 0
        print(f"{since:5.0f} s after its restart: lacks {behind:,}; {rate:,.0f} writes/s", flush=True)
        await asyncio.sleep(LOOK_SECONDS)
    print(f"{load.failed:,} writes failed", flush=True)
    return behind < CAUGHT_UP_ENTRIES


async def wait_until_caught_up(leader: Supernode, follower: Supernode) -> None:
    """Wait until the follower has all entries of the leader, at most as long as a start may take."""
    async for _ in processes.attempts():
        if await lag(leader, follower) < CAUGHT_UP_ENTRIES:
            return


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--channels", type=int, default=100_000)
    parser.add_argument("--writes-per-second", type=float, default=780.0)
    parser.add_argument("--megabits-per-second", type=float, default=8.0)
    parser.add_argument("--seconds", type=float, default=80.0)
    wanted = parser.parse_args()
    processes.PATIENCE_SECONDS = START_SECONDS_MAX
    caught_up = asyncio.run(
        measure(wanted.channels, wanted.writes_per_second, wanted.megabits_per_second, wanted.seconds)
    )
    print("it caught up" if caught_up else "it did not catch up", flush=True)
    return 0 if caught_up else 1


if __name__ == "__main__":
    sys.exit(main())
