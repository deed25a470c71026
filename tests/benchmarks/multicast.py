"""The bytes that leave a host for 1, 8 and 32 readers, over ordinary subscriptions and over multicast.

`python -m tests.benchmarks.multicast` (root, Linux): a host in one network namespace, all readers in one process in
another. A producer puts ITEMS items of 18 KB, then ITEMS of 200 B. The kernel counts the bytes that the host sends on
its link, with all packet headers. `host s`: the CPU time of the host.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.namespaces import NamespaceNetwork, NetworkNamespace

ITEMS = 300
SIZES = (18_000, 200)
READERS = (1, 8, 32)
EVERY_S = 0.005
WAYS: tuple[Literal["multicast"] | None, ...] = (None, "multicast")


def read(namespace: NetworkNamespace, address: str, name: str, readers: int, via: Any, sender: Any) -> None:
    """Read the channel with all readers. Sends "begun" when all readers follow it, and the counts at the end."""
    namespace.enter()
    asyncio.run(_read(address, name, readers, via, sender))


async def _read(address: str, name: str, readers: int, via: Literal["multicast"] | None, sender: Any) -> None:
    begun = 0

    async def one(channel: Any) -> tuple[int, int]:
        nonlocal begun
        count = 0
        async with channel.subscribe(via=via) as subscription:
            async for item in subscription:
                if item.payload == b"warm":
                    if not begun_by.get(id(subscription)) and (via is None or subscription.multicast.following):
                        begun_by[id(subscription)] = True
                        begun += 1
                        if begun == readers:
                            sender.send("begun")
                    continue
                if item.payload == b"end":
                    break
                count += 1
            return count, subscription.multicast.repairs if via else 0

    begun_by: dict[int, bool] = {}
    async with aio.connect(address, transport="grpc") as rt:
        channel = await rt.channel(name, create=False)
        found = await asyncio.gather(*(one(channel) for _ in range(readers)))
    sender.send((min(count for count, _ in found), sum(repairs for _, repairs in found)))


def measure(rig: tuple[LocalCluster, Any, list[NetworkNamespace]], readers: int, via: Any, size: int) -> str:
    """One row of the table."""
    cluster, rt, (host, other) = rig
    channel = rt.channel(f"bench/{readers}-{via}-{size}", max_items=10**5)
    spawn = multiprocessing.get_context("spawn")
    receiver, sender = spawn.Pipe(duplex=False)
    process = spawn.Process(target=read, args=(other, cluster.address, channel.name, readers, via, sender))
    process.start()
    while not receiver.poll(0.05):
        channel.put(b"warm")
    receiver.recv()
    with counted(host, cluster.hosts[0].pid) as used:
        for _ in range(ITEMS):
            channel.put(os.urandom(size))
            time.sleep(EVERY_S)
        channel.put(b"end")
        count, repairs = receiver.recv()
    process.join(20)
    megabytes, cpu_s = used
    return (
        f"| {size} B | {readers} | {via or 'stream'} | {megabytes:.2f} | {cpu_s:.2f} | {count} of {ITEMS} | {repairs} |"
    )


@contextmanager
def counted(host: NetworkNamespace, pid: int) -> Iterator[list[float]]:
    """The megabytes that the host sent in the block, and the seconds of its CPU time."""
    used: list[float] = []
    before = _sent_bytes(host), _cpu_s(pid)
    yield used
    used += [(_sent_bytes(host) - before[0]) / 1e6, _cpu_s(pid) - before[1]]


def _sent_bytes(host: NetworkNamespace) -> int:
    return int(Path(f"/sys/class/net/{host.outer_link}/statistics/rx_bytes").read_text())


def _cpu_s(pid: int) -> float:
    """The CPU time of a process and its children."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    own = (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")
    return own + sum(_cpu_s(int(child)) for child in children)


def main() -> None:
    """Print the table."""
    print("| items | readers | via | sent MB | host s | items got | repairs |\n" + "| --- " * 7 + "|")
    with NamespaceNetwork(2) as network:
        cluster = LocalCluster(
            hosts=1, supernodes=1, durable=False, listen=f"{network.address}:0", multicast="239.255.7.7:7587",
            host_namespaces=network.namespaces[:1], allow_insecure_anywhere=True,
        )  # fmt: skip
        with cluster:
            os.environ["STAMPEDE_SECRET_FILE"] = str(cluster.secret_file)
            with st.connect(cluster.address, transport="grpc") as rt:
                for size in SIZES:
                    for readers in READERS:
                        for via in WAYS:
                            print(measure((cluster, rt, network.namespaces), readers, via, size), flush=True)


if __name__ == "__main__":
    main()
