"""Members in this process over real gRPC on the loopback, with real stores."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import grpc
import grpc.aio

from stampede_rt_supernode.replication import (
    CHANNEL_OPTIONS,
    ChangeUnderWay,
    LogUnavailable,
    Member,
    NotLeading,
    OutcomeUnknown,
    RaftTiming,
    ReplicatedLog,
    ReplicationSettings,
    ReplicationStatus,
    open_replicated_log,
)
from tests.support.supernode.list_machine import ListMachine

QUICK = RaftTiming(
    heartbeat_seconds=0.05,
    election_timeout_min_seconds=0.3,
    election_timeout_max_seconds=0.6,
    leader_fallback_seconds=0.6,
    reconnect_seconds=0.1,
)
# For tests of one leader: a busy machine may stop it for longer than the other periods allow.
STEADY = replace(QUICK, election_timeout_min_seconds=1.5, election_timeout_max_seconds=3.0, leader_fallback_seconds=3.0)
ACKNOWLEDGED_SECONDS = 10.0


def dial(address: str) -> grpc.aio.Channel:
    return grpc.aio.insecure_channel(address, options=CHANNEL_OPTIONS)


class LiveMember:
    """One member. Its folder and address stay. Each start makes another log and server."""

    def __init__(self, member_id: str, folder: Path | None, on_fatal: Callable[[BaseException], None]) -> None:
        self.folder = folder
        self.machine = ListMachine()
        self._on_fatal = on_fatal
        self.server = grpc.aio.server(options=[("grpc.so_reuseport", 0)])
        self.port = self.server.add_insecure_port("127.0.0.1:0")
        self.member = Member(member_id=member_id, address=f"127.0.0.1:{self.port}")
        self.log: ReplicatedLog | None = None
        # The members that it learned of when it volunteered; None for a founder.
        self.known_members: list[Member] | None = None

    async def start(
        self, members: list[Member], timing: RaftTiming, *, snapshot_every: int, joining: bool = False
    ) -> None:
        if self.log is None and self.server is None:
            self.server = grpc.aio.server(options=[("grpc.so_reuseport", 0)])
            assert self.server.add_insecure_port(f"127.0.0.1:{self.port}") == self.port
        self.machine = ListMachine()
        settings = ReplicationSettings(
            self_member=self.member,
            initial_members=members,
            joining=joining,
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
        self._folder = folder
        self.all = [self._made(number) for number in range(size)]
        self.members = [each.member for each in self.all]

    def _made(self, number: int) -> LiveMember:
        folder = self._folder / str(number) if self._folder else None
        return LiveMember(f"m{number}", folder, self.failures.append)

    async def volunteer(self) -> LiveMember:
        """A new process that waits to be added."""
        newcomer = self._made(len(self.all))
        newcomer.known_members = list(running(await self.leader()).status().members)
        self.all.append(newcomer)
        await self.start(newcomer)
        return newcomer

    async def add(self, newcomer: LiveMember) -> int:
        return await self.on_leader(lambda log: log.add_member(newcomer.member, timeout=10.0))

    async def on_leader(self, change: Callable[[ReplicatedLog], Awaitable[int]]) -> int:
        """Have the leader make the change, or the next leader if the first one is replaced. Tries again after
        LogUnavailable.
        """
        async with asyncio.timeout(30.0):
            while True:
                try:
                    return await change(running(await self.leader()))
                except (NotLeading, ChangeUnderWay, LogUnavailable):
                    continue

    async def remove(self, member: LiveMember) -> None:
        """Remove a member, through the present leader, and stop it."""
        await self.on_leader(lambda log: log.remove_member(member.member.member_id, timeout=10.0))
        self.all.remove(member)
        await member.stop()

    async def __aenter__(self) -> LiveCluster:
        for each in self.all:
            await self.start(each)
        return self

    async def start(self, member: LiveMember) -> None:
        members, joining = member.known_members or self.members, member.known_members is not None
        await member.start(members, self._timing, snapshot_every=self._snapshot_every, joining=joining)

    async def __aexit__(self, *exc_info: object) -> None:
        for each in self.all:
            await each.stop()
        if self.failures:
            raise self.failures[0]

    async def leader(self, *, within: float = 10.0) -> LiveMember:
        """Wait until all running members agree on the leader, and return it. Newcomers count once they have joined."""
        found: list[LiveMember] = []

        def agreed() -> bool:
            members = [each for each in self.all if each.log and _is_in(each.log.status())]
            statuses = {each.member.member_id: running(each).status() for each in members}
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


def _is_in(status: ReplicationStatus) -> bool:
    """Whether the member counts itself as one. It may learn of its removal from a refusal, before it reads the log."""
    return not status.removed and any(member.member_id == status.self_id for member in status.members)


async def until(condition: Callable[[], bool], *, within: float = 10.0) -> None:
    """Wait for a condition that no event announces."""
    async with asyncio.timeout(within):
        while not condition():  # noqa: ASYNC110 - a status is a value, and nothing announces its change
            await asyncio.sleep(0.005)


async def proposed(member: LiveMember, command: bytes) -> bytes:
    """Propose until the command is acknowledged. If the leader changes, the log may have the command twice."""
    while True:  # ends with the test's time limit
        with contextlib.suppress(OutcomeUnknown, LogUnavailable):
            return await running(member).propose(command, timeout=ACKNOWLEDGED_SECONDS)


def commands_of(member: LiveMember) -> list[bytes]:
    """The member's commands in their order, each once."""
    return list(dict.fromkeys(command for _, command in member.machine.entries))


def running(member: LiveMember) -> ReplicatedLog:
    assert member.log is not None
    return member.log
