"""The cost of a put and a get of a channel that many groups share."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import stampede_rt as st
from stampede_rt_bench.clusters import secret_found
from stampede_rt_bench.measuring import NANOS_PER_US, PAYLOAD_BYTES, Spread
from stampede_rt_local.cluster import LocalCluster


def measure_groups(counts: Sequence[int], operations: int, runs: int) -> dict[int, dict[str, Spread]]:
    """By the number of groups, the CPU time of the host's process for a put, a get, and a get through a group."""
    costs: dict[int, dict[str, Spread]] = {}
    payload = bytes(PAYLOAD_BYTES)
    with (
        LocalCluster(hosts=1, supernodes=1, durable=False) as cluster,
        secret_found(cluster),
        st.connect(cluster.address, transport="socket") as rt,  # shared memory costs the host nothing
    ):
        channel, other = rt.channel("bench/shared", max_items=100), rt.channel("bench/other", max_items=100)
        groups: list[st.Group] = []
        for count in counts:
            while len(groups) < count:
                groups.append(rt.group(f"bench/{len(groups)}", [channel, other]))
            for group in groups:
                group.newest()  # from now on the host knows the group
            other.put(payload)
            calls_by_name: dict[str, Callable[[], object]] = {
                "put": lambda: channel.put(payload),
                "put that moves all cuts": _in_turn(other, channel, payload),
                "get of the newest": channel.newest,
                "get through a group": groups[0][channel].newest,
            }
            costs[count] = {
                name: Spread.of([_host_us(cluster.hosts[0].pid, call, max(1, operations // 4)) for _ in range(runs)])
                for name, call in calls_by_name.items()
            }
    return costs


def _in_turn(one: st.Channel, other: st.Channel, payload: bytes) -> Callable[[], object]:
    """Put into the two channels alternately, so that every put moves the cuts of their groups."""
    turns = itertools.cycle((one, other))
    return lambda: next(turns).put(payload)


def _host_us(pid: int, call: Callable[[], object], calls: int) -> float:
    before = _cpu_nanos(pid)
    for _ in range(calls):
        call()
    return (_cpu_nanos(pid) - before) / calls / NANOS_PER_US


def _cpu_nanos(pid: int) -> int:
    """The processor time of all threads of a process."""
    files = Path(f"/proc/{pid}/task").glob("*/schedstat")
    return sum(int(file.read_text().split()[0]) for file in files)
