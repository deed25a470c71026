"""A member that opens a large snapshot goes on answering its leader, and none of its steps takes more than a piece."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

import pytest

from stampede_rt_supernode.replication.interface import ReleaseTooOld
from stampede_rt_supernode.replication.storage import store as storage
from stampede_rt_supernode.replication.storage.store import MemoryStore, StoreChanges
from stampede_rt_supernode.replication.threads.worker_thread import Result
from stampede_rt_supernode.replication.wire.messages import AppendReply, Message
from tests.support.supernode.list_machine import ListMachine
from tests.support.supernode.lone_node import LoneNode, append, piece, snapshot_pieces

T = TypeVar("T")


class Background:
    """Stands for another thread: does its work when the test tells it."""

    def __init__(self) -> None:
        self._work: list[Callable[[], None]] = []

    def __call__(self, work: Callable[[], T], /) -> Result[T]:
        future: Future[T] = Future()
        self._work.append(lambda: future.set_result(work()))
        return future

    def do_it(self) -> None:
        while self._work:
            self._work.pop(0)()


def answers(sent: list[tuple[str, Message]]) -> list[AppendReply]:
    """The messages, which must all be answers to a leader."""
    replies = [message for _, message in sent if isinstance(message, AppendReply)]
    assert len(replies) == len(sent)
    return replies


class SlowDecoding:
    """A node that is being sent the snapshot up to entry 9 of term 5, and another thread that decodes it."""

    def __init__(self, store: MemoryStore | None = None) -> None:
        self.background = Background()
        self.lone = LoneNode(store=store, run_in_background=self.background)

    def receive_all(self, *, last: int = 9) -> None:
        for chunk in snapshot_pieces(last=last, term=5):
            replies = answers(self.lone.receive("b", piece(5, chunk, commit=12)))
            assert [(reply.success, reply.reset) for reply in replies] == [(False, False)]

    def open_it(self) -> None:
        self.background.do_it()
        self.lone.open_snapshot()


def test_a_leader_gets_answers_and_does_not_send_a_snapshot_again_while_a_member_decodes_it() -> None:
    slow = SlowDecoding()
    slow.receive_all()
    for _ in range(3):
        slow.lone.open_snapshot()
        [reply] = answers(slow.lone.receive("b", append(5, (9, 5), [(10, 5)], commit=12)))
        assert (reply.success, reply.reset, reply.term) == (False, False, 5)
    assert slow.lone.machine.entries == []
    slow.open_it()
    [reply] = answers(slow.lone.receive("b", append(5, (9, 5), [(10, 5)], commit=12)))
    assert (reply.success, reply.next_index) == (True, 11)


def test_pieces_that_arrive_while_a_snapshot_is_decoded_are_sent_again_later() -> None:
    slow = SlowDecoding()
    slow.receive_all()
    slow.lone.receive("b", append(5, (9, 5), [(10, 5)], commit=12))
    slow.open_it()
    [reply] = answers(slow.lone.receive("b", append(5, (10, 5), [(11, 5)], commit=12)))
    assert (reply.success, reply.reset, reply.next_index) == (False, True, 10)


def test_entries_that_arrive_before_the_snapshot_is_decoded_are_kept() -> None:
    slow = SlowDecoding()
    slow.receive_all()
    slow.lone.receive("c", append(6, (1, 0), [(index, 5) for index in range(2, 13)], commit=12))
    slow.lone.tick()
    slow.open_it()
    assert slow.lone.machine.entries[-1] == (12, b"12/5")
    assert not slow.lone.node.keeper.is_opening


def test_a_second_snapshot_does_not_disturb_the_first() -> None:
    slow = SlowDecoding()
    slow.receive_all()
    slow.receive_all(last=20)
    slow.open_it()
    assert slow.lone.held() == [(8, 5), (9, 5)]
    slow.receive_all(last=20)
    slow.open_it()
    assert slow.lone.held() == [(19, 5), (20, 5)]


def test_a_member_that_decodes_a_snapshot_begins_no_snapshot_of_its_own() -> None:
    slow = SlowDecoding()
    slow.receive_all()
    slow.lone.node.request_snapshot()
    slow.lone.tick()
    assert not slow.lone.node.keeper.is_taking


class WatchedCommits(MemoryStore):
    """Counts the pieces of each commit."""

    def __init__(self) -> None:
        self.pieces: list[int] = []

    def commit(self, changes: StoreChanges) -> None:
        self.pieces.append(len(changes.pieces))


def test_each_step_writes_one_piece_and_the_last_one_opens_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(storage, "PIECE_BYTES", 40)
    store = WatchedCommits()
    slow = SlowDecoding(store)
    slow.receive_all()
    slow.background.do_it()
    while slow.lone.node.keeper.is_opening:
        assert slow.lone.machine.entries == []
        slow.lone.node.install_opened()
        slow.lone.log.sync()
    snapshot = slow.lone.log.snapshot
    assert snapshot is not None
    assert store.pieces[-1] == 0
    assert [count for count in store.pieces if count] == [1] * snapshot.pieces_count
    assert snapshot.pieces_count > 3
    assert slow.lone.machine.entries[-1] == (9, b"9/5")


def test_a_snapshot_that_cannot_be_decoded_raises_an_error_before_any_acknowledgement() -> None:
    failed: Future[object] = Future()
    failed.set_exception(ValueError("this state cannot be read"))
    lone = LoneNode(run_in_background=lambda work, /: failed)  # type: ignore[arg-type,return-value]
    for chunk in snapshot_pieces(last=9, term=5):
        lone.receive("b", piece(5, chunk, commit=12))
    with pytest.raises(ValueError, match="cannot be read"):
        lone.open_snapshot()


class OlderState(ListMachine):
    """The state of a release that does not know the level of any snapshot."""

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        raise ReleaseTooOld(1, 2)


def test_a_snapshot_above_the_level_of_this_release_stops_this_member_and_does_not_blame_the_sender() -> None:
    lone = LoneNode(machine=OlderState())
    for chunk in snapshot_pieces(last=9, term=5):
        lone.receive("b", piece(5, chunk, commit=9))
    with pytest.raises(ReleaseTooOld):
        lone.open_snapshot()
    assert lone.held() == [(1, 0)]
