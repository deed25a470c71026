"""A producer collects items, cuts runs of them, and knows the bytes of the runs that have no ack."""

from __future__ import annotations

import pytest

from stampede_rt.wire.batching import NumberedRun, RunBuilder, UnackedRuns, WaitingItem
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.runs import RUN_BYTES_MAX, encode_run, run_parts


def item(payload: bytes = b"x", time: int | None = None, duration: int | None = None, kind: str = "") -> WaitingItem:
    return payload, time, duration, None, kind


def runs_of(*items: WaitingItem) -> list[NumberedRun]:
    builder, runs = RunBuilder(), list[NumberedRun]()
    for one in items:
        builder.add(one, len(one[0]))
    while len(builder):
        runs.append(builder.cut())
        builder.drop(runs[-1])
    return runs


def test_the_bytes_without_an_ack_are_the_charged_bytes_of_their_runs() -> None:
    unacked = UnackedRuns()
    assert unacked.length_bytes == 0
    for run in runs_of(item(b"a" * 10), item(b"b" * 20, kind="text/plain"), item(b"c" * 30)):
        unacked.add(run)
    assert unacked.length_bytes == 60 + 3 * 64
    unacked.take_gathered()
    unacked.acknowledge(0)
    assert unacked.length_bytes == 50 + 2 * 64
    unacked.acknowledge(0)
    unacked.acknowledge(0)
    assert unacked.length_bytes == 0


def test_an_item_that_has_no_room_is_not_added() -> None:
    builder = RunBuilder()
    assert builder.add_within(item(bytes(RUN_BYTES_MAX)), RUN_BYTES_MAX)
    assert not builder.add_within(item(b"x"), 1)
    assert len(builder) == 1
    few = RunBuilder()
    assert all(few.add_within(item(), 1) for _ in range(RUN_ITEMS_MAX))
    assert not few.add_within(item(), 1)
    assert (len(few), few.length_bytes) == (RUN_ITEMS_MAX, RUN_ITEMS_MAX)


def test_a_single_item_of_any_length_has_room() -> None:
    builder = RunBuilder()
    assert builder.add_within(item(bytes(2 * RUN_BYTES_MAX)), 2 * RUN_BYTES_MAX)


@pytest.mark.parametrize(
    ("items", "lengths"),
    [
        ([item(time=1), item(time=2), item()], [2, 1]),
        ([item(), item(kind="a"), item(kind="a")], [1, 2]),
        ([item(duration=5), item()], [2]),
        ([item(bytes(RUN_BYTES_MAX - 1)), item(b"xy")], [1, 1]),
    ],
)
def test_items_that_do_not_fit_together_come_into_runs_of_their_own(
    items: list[WaitingItem], lengths: list[int]
) -> None:
    assert [run.items for run in runs_of(*items)] == lengths


@pytest.mark.parametrize(("length", "pieces"), [(64, 1), (1023, 1), (1024, 4), (18_000, 4)])
def test_short_payloads_of_a_run_are_one_piece(length: int, pieces: int) -> None:
    payloads = [bytes((number,)) * length for number in range(3)]
    parts = run_parts(payloads, times=None)
    assert len(parts) == pieces
    assert b"".join(parts) == encode_run(payloads, times=None)
