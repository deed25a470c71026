"""Snapshots on request: their contents, the moment of the answer, and a readable store after a kill at any commit."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from stampede_rt_supernode.replication.arrivals import SNAPSHOT_REQUESTS_MAX
from stampede_rt_supernode.replication.interface import LogUnavailable, Member
from stampede_rt_supernode.replication.raft_replica import RaftReplica
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.member_change import MemberChange
from stampede_rt_supernode.replication.rules.proposals import Outcome, Proposal
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotOutcome, SnapshotRequest
from stampede_rt_supernode.replication.settings import RaftTiming, ReplicationSettings
from stampede_rt_supernode.replication.storage import store as storage
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore
from stampede_rt_supernode.replication.storage.store import (
    MemoryStore,
    Store,
    StoreChanges,
    StoredSnapshot,
    StoredState,
)
from stampede_rt_supernode.replication.wire.records import decode_snapshot
from tests.support.supernode.list_machine import ListMachine


class EmptyNetwork:
    """A network without other members."""

    def release(self, messages: object) -> None:
        raise AssertionError("there is nobody to send to")

    def has_room(self, member_id: str) -> bool:
        return True

    def follow(self, roster: object) -> None:
        pass


class LoneMember:
    """A cluster of one, stepped by hand, with a clock of its own."""

    def __init__(self, store: Store) -> None:
        self.now = 100.0
        self.machine = ListMachine()
        me = Member(member_id="m", address="m:1")
        settings = ReplicationSettings(self_member=me, initial_members=[me], cluster_id="c")
        self.replica = RaftReplica(
            settings,
            self.machine,
            store=store,
            network=EmptyNetwork(),
            clock=lambda: self.now,
            random_source=random.Random(1),
        )
        self.outcomes: list[Outcome | SnapshotOutcome] = []

    def step_until(self, done: Callable[[], bool]) -> None:
        for _ in range(200):
            if done():
                return
            self.now += 0.1
            self.replica.step()
        raise AssertionError("the awaited event did not happen")

    def propose(self, text: bytes) -> None:
        before = len(self.outcomes)
        self.replica.propose(Proposal(text, self.now + 60, self.outcomes.append))
        self.step_until(lambda: len(self.outcomes) > before)

    def ask(self) -> None:
        self.replica.take_snapshot(SnapshotRequest(self.outcomes.append))

    def snapshot(self) -> StoredSnapshot:
        before = len(self.outcomes)
        self.ask()
        self.step_until(lambda: len(self.outcomes) > before)
        taken = self.outcomes[-1]
        assert isinstance(taken, StoredSnapshot)
        return taken


def texts(record: bytes) -> list[bytes]:
    machine = ListMachine()
    machine.prepare_restore(decode_snapshot(record).state)()
    return [text for _, text in machine.entries]


def test_a_snapshot_holds_all_entries_that_were_applied_before_the_request() -> None:
    alone = LoneMember(MemoryStore())
    for text in (b"a", b"b"):
        alone.propose(text)
    first = alone.snapshot()
    assert texts(first.record) == [b"a", b"b"]
    assert first.last_log_index == alone.replica.status().applied_index
    alone.propose(b"c")
    assert texts(alone.snapshot().record) == [b"a", b"b", b"c"]


def test_without_a_new_entry_the_last_snapshot_is_the_answer() -> None:
    alone = LoneMember(MemoryStore())
    alone.propose(b"a")
    assert alone.snapshot() is alone.snapshot()


def test_waiting_requests_get_an_error_when_the_replica_closes() -> None:
    alone = LoneMember(MemoryStore())
    alone.ask()
    alone.replica.close()
    assert [str(one) for one in alone.outcomes] == ["this replica is closing"]


def test_waiting_changes_of_members_are_answered_when_the_replica_closes() -> None:
    alone = LoneMember(MemoryStore())
    alone.propose(b"a")
    newcomer = Member(member_id="n", address="n:1")
    answers: list[object] = []
    alone.replica.change_members(MemberChange(newcomer, False, answers.append))
    alone.replica.change_members(HandOver(answers.append))
    alone.replica.close()
    assert sorted(str(one) for one in answers) == ["False", "this replica is closing"]


def test_the_number_of_waiting_requests_is_limited() -> None:
    alone = LoneMember(MemoryStore())
    for _ in range(SNAPSHOT_REQUESTS_MAX):
        alone.ask()
    with pytest.raises(LogUnavailable, match="try again"):
        alone.ask()


def test_a_single_replica_makes_long_pauses_only_while_no_call_waits() -> None:
    alone = LoneMember(MemoryStore())
    timing = RaftTiming()
    assert alone.replica.pause_seconds() == timing.tick_seconds  # the replica does not lead yet
    alone.propose(b"a")

    def propose(text: bytes) -> None:
        alone.replica.propose(Proposal(text, alone.now + 60, alone.outcomes.append))

    for ask in (partial(propose, b"b"), alone.ask, partial(propose, b"c")):
        alone.step_until(lambda: alone.replica.pause_seconds() == timing.idle_seconds)
        answers = len(alone.outcomes)
        ask()
        while True:
            has_more_work = alone.replica.step()
            if len(alone.outcomes) > answers:
                break
            assert has_more_work or alone.replica.pause_seconds() == timing.tick_seconds
            alone.now += timing.tick_seconds


class ProcessKilled(BaseException):
    """The process was killed."""


class KillableStore(SqliteStore):
    """A store whose process is killed before or after one of its commits."""

    commits_left = 10**9
    dies_after = False

    def commit(self, changes: StoreChanges) -> None:
        self.commits_left -= 1
        if self.commits_left == 0 and not self.dies_after:
            raise ProcessKilled
        super().commit(changes)
        if self.commits_left == 0:
            raise ProcessKilled


@pytest.mark.parametrize("dies_after", [False, True])
def test_a_kill_at_any_commit_of_a_snapshot_loses_nothing_acknowledged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dies_after: bool
) -> None:
    monkeypatch.setattr(storage, "PIECE_BYTES", 64)
    survived = 0
    for commits in range(1, 40):
        folder = tmp_path / str(commits)
        store = KillableStore(folder, cluster_id="c", member_id="m", create=True)
        alone = LoneMember(store)
        for number in range(12):
            alone.propose(b"text %d" % number)
        alone.snapshot()
        alone.propose(b"text 12")
        store.commits_left, store.dies_after = commits, dies_after
        try:
            alone.snapshot()
        except ProcessKilled:
            store.close()
        else:
            survived += 1
            store.close()
        held = reopened(folder)
        assert held.snapshot is not None
        restarted = LoneMember(SqliteStore(folder, cluster_id="c", member_id="m", create=False))
        restarted.step_until(lambda restarted=restarted: len(restarted.machine.entries) == 13)  # type: ignore[misc]
        assert [text for _, text in restarted.machine.entries] == [b"text %d" % number for number in range(13)]
        restarted.replica.close()
        if survived:
            break
    assert survived
    assert commits > 3  # the kills came at every commit that a snapshot takes


def reopened(folder: Path) -> StoredState:
    store = SqliteStore(folder, cluster_id="c", member_id="m", create=False)
    try:
        return store.load()
    finally:
        store.close()
