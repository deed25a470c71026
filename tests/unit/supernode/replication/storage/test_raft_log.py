"""The log over every store: synced entries come back, unsynced ones are gone."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.log_entries import Entry
from stampede_rt_supernode.replication.storage import store as storage
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.sqlite_store import SqliteStore
from stampede_rt_supernode.replication.storage.store import Store, StoredSnapshot
from tests.support.supernode.simulated_disk import Disk, DiskStore

Reopen = Callable[[], Store]

NOBODY = Configuration(())


def sqlite_in(folder: Path) -> Reopen:
    opened: list[SqliteStore] = []

    def reopen() -> Store:
        for store in opened:
            store.close()
        opened[:] = [SqliteStore(folder, cluster_id="c", member_id="m", create=True)]
        return opened[0]

    return reopen


@pytest.fixture(params=["sqlite", "simulated disk"])
def reopen(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Reopen]:
    """Open the store again, as after a crash: uncommitted writes are gone."""
    if request.param == "sqlite":
        make = sqlite_in(tmp_path)
        yield make
        make().close()
    else:
        disk = Disk()
        yield lambda: DiskStore(disk)


def with_entries(store: Store, last: int) -> RaftLog:
    log = RaftLog(store)
    for index in range(1, last + 1):
        log.append(b"\x00%d" % index, index, 1)
    return log


def adopt(log: RaftLog, snapshot: StoredSnapshot, previous: Entry, last: Entry) -> None:
    for piece in snapshot.pieces():
        log.write_piece(piece)
    log.adopt_snapshot(snapshot, previous, last, NOBODY)


def test_a_new_store_is_empty(reopen: Reopen) -> None:
    log = RaftLog(reopen())
    assert (len(log), log.term, log.voted_for) == (0, 0, None)
    assert log.commit_index == 1


def test_a_crash_keeps_only_the_synced_entries(reopen: Reopen) -> None:
    log = with_entries(reopen(), 3)
    log.set_term(4, "b")
    log.commit_index = 2
    assert log.sync()
    log.append(b"\x00lost", 4, 4)
    log.set_term(5, "c")
    reopened = RaftLog(reopen())
    assert [entry.log_index for entry in reopened[:]] == [1, 2, 3]
    assert (reopened.term, reopened.voted_for, reopened.commit_index) == (4, "b", 2)


def test_a_change_of_only_the_commit_index_is_not_written(reopen: Reopen) -> None:
    log = with_entries(reopen(), 3)
    assert log.sync()
    log.commit_index = 3
    assert not log.sync()


def test_a_replaced_tail_of_the_log_does_not_return(reopen: Reopen) -> None:
    log = with_entries(reopen(), 5)
    log.sync()
    log.cut_from(4)
    log.append(b"\x00new", 4, 2)
    log.sync()
    assert [tuple(entry)[1:] for entry in RaftLog(reopen())[:]] == [(1, 1), (2, 1), (3, 1), (4, 2)]


def test_a_store_opens_after_a_snapshot_that_ends_at_another_entry_of_the_same_term(reopen: Reopen) -> None:
    log = with_entries(reopen(), 8)
    log.sync()
    previous, last = log[4], Entry(b"\x00forged", 6, 1)
    adopt(log, StoredSnapshot.of(6, b"state"), previous, last)
    log.sync()
    assert RaftLog(reopen())[:] == [previous, last]


def test_the_snapshot_and_the_trimmed_log_are_written_in_one_transaction(reopen: Reopen) -> None:
    log = with_entries(reopen(), 8)
    log.sync()
    previous, last = log[4], log[5]
    adopt(log, StoredSnapshot.of(6, b"state"), previous, last)
    before = RaftLog(reopen())
    assert (len(before), before.snapshot) == (8, None)
    previous, last = before[4], before[5]
    adopt(before, StoredSnapshot.of(6, b"state"), previous, last)
    before.sync()
    after = RaftLog(reopen())
    assert [entry.log_index for entry in after[:]] == [5, 6, 7, 8]
    assert after.snapshot == StoredSnapshot.of(6, b"state")


def test_a_snapshot_in_pieces_is_valid_from_its_last_piece_on(reopen: Reopen, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "PIECE_BYTES", 2)
    log = with_entries(reopen(), 8)
    adopt(log, StoredSnapshot.of(3, b"older"), log[1], log[2])
    log.sync()
    arriving = StoredSnapshot.of(6, b"state")
    assert [piece.data for piece in arriving.pieces()] == [b"st", b"at", b"e"]
    for piece in arriving.pieces():
        log.write_piece(piece)
        log.sync()
        log = RaftLog(reopen())
        assert (log[0].log_index, log.snapshot) == (2, StoredSnapshot.of(3, b"older"))
    log.adopt_snapshot(arriving, log[3], log[4], NOBODY)
    log.sync()
    reopened = RaftLog(reopen())
    assert (reopened[0].log_index, reopened.snapshot) == (5, arriving)


def test_pieces_of_a_killed_process_do_not_disturb_the_next_snapshot(
    reopen: Reopen, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "PIECE_BYTES", 2)
    log = with_entries(reopen(), 8)
    for piece in StoredSnapshot.of(6, b"much longer").pieces():
        log.write_piece(piece)
    log.sync()
    reopened = RaftLog(reopen())
    adopt(reopened, StoredSnapshot.of(6, b"state"), reopened[4], reopened[5])
    reopened.sync()
    assert RaftLog(reopen()).snapshot == StoredSnapshot.of(6, b"state")


def test_a_gap_between_entries_is_refused(reopen: Reopen) -> None:
    log = with_entries(reopen(), 3)
    with pytest.raises(AssertionError, match="does not follow"):
        log.append(b"\x00", 5, 1)


steps = st.lists(
    st.one_of(
        st.tuples(st.just("add"), st.integers(1, 4)),
        st.tuples(st.just("cut"), st.integers(0, 12)),
        st.tuples(st.just("snapshot"), st.integers(2, 30)),
        st.tuples(st.just("piece"), st.integers(2, 30)),
        st.tuples(st.just("sync"), st.just(0)),
        st.tuples(st.just("crash"), st.just(0)),
    ),
    max_size=25,
)


def take_step(log: RaftLog, step: str, number: int) -> None:
    match step:
        case "add":
            for _ in range(number):
                log.append(b"\x00", log[-1].log_index + 1, max(number, log[-1].term))  # terms never fall
        case "cut" if number >= 2:
            log.cut_from(log[0].log_index + number)
        case "snapshot" if number > log[0].log_index + 1:
            previous, last = Entry(b"\x00p", number - 1, 9), Entry(b"\x00l", number, 9)
            if (held := log.entry_at(number)) is not None:
                previous, last = log.entry_at(number - 1) or previous, held
            adopt(log, StoredSnapshot.of(number, b"%d" % number), previous, last)
        case "piece":
            held = 0 if log.snapshot is None else log.snapshot.last_log_index
            log.write_piece(StoredSnapshot.of(held + number, b"never complete").piece(0))
        case "sync":
            log.sync()


@settings(max_examples=60, deadline=None)
@given(steps)
def test_a_crash_takes_the_journal_back_to_its_last_sync(scenario: list[tuple[str, int]]) -> None:
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(storage, "PIECE_BYTES", 1)
        reopen = sqlite_in(Path(folder))
        log = with_entries(reopen(), 2)
        log.sync()
        durable = (log[:], log.snapshot)
        for step, number in scenario:
            take_step(log, step, number)
            if step == "sync":
                durable = (log[:], log.snapshot)
            if step == "crash":
                log = RaftLog(reopen())
                assert (log[:], log.snapshot) == durable
        log = RaftLog(reopen())
        assert (log[:], log.snapshot) == durable
        reopen().close()
