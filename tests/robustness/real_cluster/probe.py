"""Measures when the directory serves, and when this process itself did not run."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections.abc import Awaitable, Callable, Sequence

import grpc

from stampede_rt.v1 import directory_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_runtime.identity import Role
from tests.robustness.real_cluster.cluster import Cluster, request_id
from tests.robustness.real_cluster.supernode import Supernode

PROBE_HOST = "robust-probe"
PROBE_NAMES = 50
STALL_SECONDS_MIN = 0.05

Write = Callable[[Supernode, float], Awaitable[None]]


async def register_probe_host(node: Supernode, patience_s: float) -> None:
    """Register a host: a write that always adds an entry to the log.

    The directory may then choose this host as an owner of channels.
    """
    request = pb.RegisterHostRequest(
        request_id=request_id(),
        host_id=b"p" * 16,
        name=PROBE_HOST,
        gatekeepers=[directory_pb2.Endpoint(target="localhost:1")],
        boot_incarnation=1,
    )
    await node.stub_for(Role.HOST, PROBE_HOST).RegisterHost(request, timeout=patience_s)


class ChannelWrites:
    """Writes as a client: creates a channel and deletes it. For clusters in which every host must be a real one."""

    def __init__(self) -> None:
        self._turn = 0

    async def __call__(self, node: Supernode, patience_s: float) -> None:
        self._turn += 1
        name = f"robust-probe/{self._turn % PROBE_NAMES}"
        opened = await node.stub.OpenChannel(
            pb.OpenChannelRequest(request_id=request_id(), name=name, create=True), timeout=patience_s
        )
        forget = pb.DeleteChannelRequest(request_id=request_id(), channel_id=opened.channel.channel_id)
        # the write was acknowledged; if the delete fails, a later round finds the channel
        with contextlib.suppress(grpc.aio.AioRpcError):
            await node.stub.DeleteChannel(forget, timeout=patience_s)


class Probe:
    """Sends a write at regular times, to each supernode in turn, without waiting for earlier writes.

    `served`: the times (sent, answered) of the acknowledged writes. `stalls`: the times at which this process was late,
    and by how much. The figures may be too high by these delays, because this process had no processor meanwhile.
    """

    def __init__(self, cluster: Cluster, write: Write, *, every_s: float = 0.1, patience_s: float = 6.0) -> None:
        self._cluster, self._write, self._every_s, self._patience_s = cluster, write, every_s, patience_s
        self.served: list[tuple[float, float]] = []
        self.stalls: list[tuple[float, float]] = []
        self._wakeup = asyncio.Condition()

    async def run(self) -> None:
        """Probe until cancelled."""
        pending: set[asyncio.Task[None]] = set()
        turn = 0
        try:
            while True:
                node, turn = self._cluster.supernodes[turn % len(self._cluster.supernodes)], turn + 1
                pending.add(task := asyncio.create_task(self.write(node)))
                task.add_done_callback(pending.discard)
                due = time.monotonic() + self._every_s
                await asyncio.sleep(self._every_s)
                if (late_s := time.monotonic() - due) > STALL_SECONDS_MIN:
                    self.stalls.append((due, late_s))
        finally:
            for task in pending:
                task.cancel()

    async def write(self, node: Supernode) -> None:
        """Send one write. Its acknowledgement counts as service."""
        invoked = time.monotonic()
        try:
            await self._write(node, self._patience_s)
        except grpc.aio.AioRpcError:
            return
        self.served.append((invoked, time.monotonic()))
        async with self._wakeup:
            self._wakeup.notify_all()

    def longest_gap_s(self, began: float, ended: float) -> float:
        """The longest time between two acknowledged writes, or between one of them and the beginning or end of the
        period.
        """
        answered = sorted(moment for _, moment in self.served if began <= moment <= ended)
        return max(later - earlier for earlier, later in itertools.pairwise([began, *answered, ended]))

    def stalled_s(self, began: float, ended: float) -> float:
        """The longest time in the period for which this process itself did not run."""
        return max((late_s for due, late_s in self.stalls if began <= due <= ended), default=0.0)

    async def serves_after(self, moment: float, *, seconds: float) -> float:
        """The time from `moment` until the first acknowledgement of a write that began after `moment`.

        Raises TimeoutError.
        """
        async with asyncio.timeout(seconds), self._wakeup:
            await self._wakeup.wait_for(lambda: any(invoked >= moment for invoked, _ in self.served[-200:]))
        return min(answered for invoked, answered in self.served if invoked >= moment) - moment


async def with_background(work: Sequence[Awaitable[None]], body: Callable[[], Awaitable[None]]) -> None:
    """Run `body` while `work` runs without end. A failure of either ends both, and is raised."""
    tasks = [asyncio.ensure_future(one) for one in work]
    main = asyncio.ensure_future(body())
    try:
        done, _ = await asyncio.wait([main, *tasks], return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in (main, *tasks):
            task.cancel()
        await asyncio.gather(main, *tasks, return_exceptions=True)
