"""The costs to start from a snapshot, to take one and to receive one: a part of `tests.benchmarks.directory_load`.

One replica with its store on disk, in this process. The benchmark makes its steps (ticks) one by one, and measures the
time of each: the wall time, which includes the disk and other threads and processes, and the CPU time of its thread.
Snapshots are encoded and decoded on a separate thread, as in a supernode, and every tick has writes.
"""

from __future__ import annotations

import gc
import random
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stampede_rt.values.model import Policy
from stampede_rt_supernode.codecs.command_codec import decode_result, encode_command
from stampede_rt_supernode.core.channels.commands import OpenChannel
from stampede_rt_supernode.core.cluster.commands import BeginTenure
from stampede_rt_supernode.core.commands import Command, Operation, RefusedOperation
from stampede_rt_supernode.core.hosts.commands import RegisterHost
from stampede_rt_supernode.core.records import Endpoint
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import Member
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.replication.rules.proposals import Proposal
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotOutcome, SnapshotRequest
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore
from stampede_rt_supernode.replication.storage.store import StoredSnapshot
from stampede_rt_supernode.replication.threads.worker_thread import WorkerThread
from stampede_rt_supernode.replication.wire.buffered_transport import (
    LinkConnected,
    MessageReceived,
    Outgoing,
    StreamOpened,
)
from stampede_rt_supernode.replication.wire.messages import InstallSnapshot

BATCH = 250
WRITES_PER_TICK = 16
CHANGED = 5000  # the number of entries between two snapshots of a busy supernode
STEPS_MAX = 100_000

Row = tuple[str, str]


@dataclass
class LoneReplica:
    """A replica that commits alone, or follows a leader that the benchmark plays."""

    folder: Path
    peers: tuple[str, ...] = ()
    machine: DirectoryReplica = field(default_factory=DirectoryReplica)
    worker: WorkerThread = field(default_factory=WorkerThread)
    proposed: int = 0
    longest_wall: float = 0.0
    longest_cpu: float = 0.0

    def __post_init__(self) -> None:
        members = [Member(member_id=name, address=f"{name}:1") for name in ("a", *self.peers)]
        settings = ReplicationSettings(self_member=members[0], initial_members=members, cluster_id="c")
        self.replica = RaftReplica(
            settings,
            self.machine,
            store=SqliteStore(self.folder, cluster_id="c", member_id="a", create=True),
            network=self,
            clock=time.monotonic,
            random_source=random.Random(1),
            run_in_background=self.worker.run,
        )

    def release(self, messages: Sequence[Outgoing]) -> None:
        """Do nothing: no other member listens."""

    def has_room(self, member_id: str) -> bool:
        return True

    def follow(self, roster: object) -> None:
        """Do nothing: there are no other members."""

    def step(self) -> None:
        wall, cpu = time.perf_counter(), time.thread_time()
        self.replica.step()
        self.longest_cpu = max(self.longest_cpu, time.thread_time() - cpu)
        self.longest_wall = max(self.longest_wall, time.perf_counter() - wall)

    def step_until(self, done: Callable[[], bool]) -> None:
        for _ in range(STEPS_MAX):
            if done():
                return
            self.step()
            time.sleep(0.001)  # as a supernode's own thread, which waits for arrivals
        raise AssertionError("the awaited event did not happen")

    def forget(self) -> None:
        self.longest_wall = self.longest_cpu = 0.0

    def ticks(self) -> str:
        return f"longest tick {self.longest_wall * 1e3:.0f} ms, {self.longest_cpu * 1e3:.0f} ms of CPU"

    def propose(self, operations: list[Operation]) -> list[Any]:
        """Propose the operations. The outcomes appear in the returned list."""
        outcomes: list[Any] = []
        for operation in operations:
            self.proposed += 1
            op_id = self.proposed.to_bytes(16, "big")
            command = encode_command(Command(op_id=op_id, time_unix_nano=0, operation=operation))
            self.replica.propose(Proposal(command, time.monotonic() + 60, outcomes.append))
        return outcomes

    def apply(self, operations: list[Operation]) -> None:
        outcomes = self.propose(operations)
        self.step_until(lambda: len(outcomes) == len(operations))
        refused = next((one for one in map(decode_result, outcomes) if isinstance(one, RefusedOperation)), None)
        assert refused is None, refused

    def found(self) -> None:
        self.apply([BeginTenure(supernode_id="a", tenure=1, new_cluster_id="c", new_lease_ttl_nanos=10**9)])
        host = RegisterHost(
            host_id=bytes(16),
            name="host",
            gatekeepers=(Endpoint(target="localhost:1"),),
            boot_incarnation=1,
            version="",
            new_incarnation=1,
        )
        self.apply([host])

    def open_channels(self, count: int) -> None:
        for _ in range(0, count, BATCH):
            self.apply(self.new_channels(BATCH))

    def new_channels(self, count: int) -> list[Operation]:
        return [_opening(self.proposed + number) for number in range(count)]

    def snapshot(self) -> StoredSnapshot:
        outcomes: list[SnapshotOutcome] = []
        self.replica.take_snapshot(SnapshotRequest(outcomes.append))

        def done() -> bool:
            self.propose(self.new_channels(WRITES_PER_TICK))
            return bool(outcomes)

        self.step_until(done)
        assert isinstance(outcomes[0], StoredSnapshot)
        return outcomes[0]

    def close(self) -> None:
        self.replica.close()
        self.worker.close()


def _opening(number: int) -> OpenChannel:
    rng = random.Random(number)
    return OpenChannel(
        name=f"many/{number}",
        policy=Policy(),
        create=True,
        host_name="",
        new_channel_id=rng.randbytes(16),
        new_incarnation=rng.getrandbits(60),
    )


def snapshots(folder: Path, channels: int) -> list[Row]:
    """Open `channels` channels in a directory, and measure its snapshots. Blocks for a while."""
    one = LoneReplica(folder / "one")
    one.found()
    one.open_channels(channels)
    one.snapshot()
    one.close()
    gc.disable()
    began, cpu = time.perf_counter(), time.process_time()
    restarted = LoneReplica(folder / "one", proposed=one.proposed)
    rows = [("start of a log: store read, directory decoded", _took(began, cpu))]
    gc.freeze()  # in a supernode its event loop does the rest; this benchmark has no event loop
    restarted.step_until(lambda: restarted.replica.status().is_leader)
    rows.append(_taken(restarted, "first snapshot after the start"))
    restarted.open_channels(CHANGED)
    rows.append(_taken(restarted, f"a snapshot {CHANGED:,} channels later"))
    restarted.close()
    return [*rows, _received(folder / "two", restarted)]


def _taken(one: LoneReplica, name: str) -> Row:
    one.open_channels(1)
    one.forget()
    began, cpu = time.perf_counter(), time.process_time()
    taken = one.snapshot()
    return name, f"{_took(began, cpu)}, {len(taken.record) / 1e6:.1f} MB, {one.ticks()}"


def _received(folder: Path, leader: LoneReplica) -> Row:
    """The time of a follower that gets a snapshot, from its last piece on."""
    stored = leader.replica._log.snapshot
    assert stored is not None
    keeper = SnapshotKeeper(leader.replica._log, leader.machine, lambda member_id: True)
    two = LoneReplica(folder, peers=("b", "c"))
    two.replica.deliver(LinkConnected("b"))
    two.replica.deliver(StreamOpened("b"))
    began, cpu = time.perf_counter(), time.process_time()
    is_last = False
    while not is_last:
        keeper.begin_step()
        while not is_last and (chunk := keeper.next_chunk("b")) is not None:
            message = InstallSnapshot(term=1, commit_index=stored.last_log_index, chunk=chunk)
            two.replica.deliver(MessageReceived("b", message))
            is_last = chunk.is_last
        two.step()
    two.step_until(lambda: two.machine.restored > 0)
    row = f"{_took(began, cpu)}, {two.ticks()}"
    two.close()
    return "a follower receives and opens a snapshot", row


def _took(began: float, cpu: float) -> str:
    return f"{time.perf_counter() - began:.2f} s ({time.process_time() - cpu:.2f} s of CPU)"
