"""Members in this process over real gRPC on the loopback, with real stores."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path

import grpc
import grpc.aio

from stampede_rt_supernode.replication import (
    CHANNEL_OPTIONS,
    Member,
    RaftTiming,
    ReplicatedLog,
    ReplicationSettings,
    open_replicated_log,
)
from tests.robustness.replication.machine import ListMachine

QUICK = RaftTiming(
    heartbeat_seconds=0.05,
    election_timeout_min_seconds=0.3,
    election_timeout_max_seconds=0.6,
    leader_fallback_seconds=0.6,
    reconnect_seconds=0.1,
)


def dial(address: str) -> grpc.aio.Channel:
    return grpc.aio.insecure_channel(address, options=CHANNEL_OPTIONS)


class LiveMember:
    """One member: its folder and address stay, its log and server come and go."""

    def __init__(self, member_id: str, folder: Path | None, on_fatal: Callable[[BaseException], None]) -> None:
        self.folder = folder
        self.machine = ListMachine()
        self._on_fatal = on_fatal
        self.server = grpc.aio.server(options=[("grpc.so_reuseport", 0)])
        self.port = self.server.add_insecure_port("127.0.0.1:0")
        self.member = Member(member_id=member_id, address=f"127.0.0.1:{self.port}")
        self.log: ReplicatedLog | None = None

    async def start(self, members: list[Member], timing: RaftTiming, *, snapshot_every: int) -> None:
        if self.log is None and self.server is None:
            self.server = grpc.aio.server(options=[("grpc.so_reuseport", 0)])
            assert self.server.add_insecure_port(f"127.0.0.1:{self.port}") == self.port
        self.machine = ListMachine()
        settings = ReplicationSettings(
            self_member=self.member,
            initial_members=members,
            data_dir=self.folder,
            timing=timing,
            snapshot_every_entries=snapshot_every,
        )
        self.log = await open_replicated_log(settings, self.machine, dial, self.server, on_fatal=self._on_fatal)
        await self.server.start()

    async def stop(self) -> None:
        if self.log is not None:
            await self.log.close()
        if self.server is not None:
            await self.server.stop(None)
        self.log = self.server = None


class LiveCluster:
    """Use as an async context; every failure inside a log is raised at the end."""

    def __init__(
        self, size: int, folder: Path | None, *, timing: RaftTiming = QUICK, snapshot_every: int = 5000
    ) -> None:
        self.failures: list[BaseException] = []
        self._timing = timing
        self._snapshot_every = snapshot_every
        self.all = [
            LiveMember(f"m{number}", folder / str(number) if folder else None, self.failures.append)
            for number in range(size)
        ]
        self.members = [each.member for each in self.all]

    async def __aenter__(self) -> LiveCluster:
        for each in self.all:
            await self.start(each)
        return self

    async def start(self, member: LiveMember) -> None:
        await member.start(self.members, self._timing, snapshot_every=self._snapshot_every)

    async def __aexit__(self, *exc_info: object) -> None:
        for each in self.all:
            await each.stop()
        if self.failures:
            raise self.failures[0]

    async def leader(self, *, within: float = 10.0) -> LiveMember:
        """The member that all running members take for their leader."""
        found: list[LiveMember] = []

        def agreed() -> bool:
            statuses = {each.member.member_id: each.log.status() for each in self.all if each.log}
            leaders = {status.leader_id for status in statuses.values()}
            if len(leaders) != 1 or None in leaders:
                return False
            found[:] = [each for each in self.all if each.member.member_id in leaders and each.log]
            return bool(found) and statuses[found[0].member.member_id].is_leader

        await until(agreed, within=within)
        return found[0]

    async def followers(self) -> list[LiveMember]:
        leader = await self.leader()
        return [each for each in self.all if each.log and each is not leader]


async def until(condition: Callable[[], bool], *, within: float = 10.0) -> None:
    """Wait for a condition that no event announces."""
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 - a status is a value, and nothing announces its change
            await asyncio.sleep(0.005)


def running(member: LiveMember) -> ReplicatedLog:
    assert member.log is not None
    return member.log
