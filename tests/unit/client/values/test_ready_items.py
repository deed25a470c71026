"""The items of a subscription that have come, one by one and in batches."""

from __future__ import annotations

import pickle
import sys
from array import array
from collections.abc import Callable, Iterator, Sequence
from types import FrameType
from typing import Any

import pytest
from hypothesis import given, strategies

from stampede_rt.values import ready_items
from stampede_rt.values.answers import ItemBatch
from stampede_rt.values.columns import DecodedRun, ItemColumns
from stampede_rt.values.model import Item
from stampede_rt.values.ready_items import ReadyItems, SeenSeqs

LENGTHS = strategies.lists(strategies.integers(1, 4), max_size=4)


def run(first_seq: int, length: int, *, durations: bool = False) -> ItemColumns:
    seqs = range(first_seq, first_seq + length)
    columns = DecodedRun(
        times=array("q", [10 * seq for seq in seqs]),
        durations=array("q", [5] * length) if durations else None,
        lengths=array("I", [2] * length),
        first_seq=first_seq,
        attributes={},
        content_type="",
        incarnation=1,
        payloads=b"".join(b"%02d" % seq for seq in seqs),
    )
    return ItemColumns([columns], overlap=0)


def runs_of(lengths: Sequence[int], first_seq: int = 1) -> list[Sequence[Item]]:
    """Runs of columns. Every third run is a list of items, like the result of a filter."""
    runs = list[Sequence[Item]]()
    for number, length in enumerate(lengths):
        one = run(first_seq, length)
        runs.append([*one] if number % 3 == 2 else one)
        first_seq += length
    return runs


@given(strategies.lists(strategies.one_of(LENGTHS, strategies.just("one"), strategies.just("all")), max_size=12))
def test_steps_and_batches_in_any_sequence_give_each_item_once_and_in_order(turns: list[Any]) -> None:
    ready, added, taken = ReadyItems(), 0, list[int]()
    for turn in turns:
        if turn == "one":
            if ready.items or ready.unpack():
                taken.append(ready.items.popleft().seq)
        elif turn == "all":
            taken += ready.take_all().seqs.tolist()
            assert not ready
        else:
            ready.add(runs_of(turn, added + 1))
            added += sum(turn)
        assert bool(ready) == (len(taken) < added)
    taken += [item.seq for item in ready.take_all()]
    assert taken == [*range(1, added + 1)]


@given(LENGTHS)
def test_the_columns_of_a_batch_agree_with_its_items(lengths: list[int]) -> None:
    batch = ItemBatch(runs_of(lengths))
    columns = batch.times.tolist(), batch.durations.tolist(), batch.seqs.tolist(), batch.payloads
    assert len(batch) == sum(lengths)
    assert [*zip(*columns, strict=True)] == [(item.time, -1, item.seq, item.payload) for item in batch]
    assert [batch[at] for at in range(len(batch))] == [*batch] == batch[:]
    assert [*pickle.loads(pickle.dumps(batch))] == [*batch]


def test_the_column_of_durations_has_the_durations() -> None:
    assert ItemBatch([run(1, 2, durations=True), run(3, 1)]).durations.tolist() == [5, 5, -1]


def test_a_run_without_items_is_not_ready() -> None:
    ready = ReadyItems()
    ready.add([[], []])
    assert not ready


def test_a_signal_handler_that_raises_while_items_are_made_loses_none() -> None:
    class Interrupted(list[Item]):
        was_interrupted = False

        def __iter__(self) -> Iterator[Item]:
            for item in [self[at] for at in range(len(self))]:
                yield item
                if not self.was_interrupted:
                    self.was_interrupted = True
                    raise KeyboardInterrupt

    ready = ReadyItems()
    ready.add([Interrupted(run(1, 3)), run(4, 1)])
    with pytest.raises(KeyboardInterrupt):
        ready.unpack()
    assert [item.seq for item in ready.take_all()] == [1, 2, 3, 4]


def test_an_interrupt_at_any_bytecode_of_an_unpacking_neither_loses_nor_repeats_an_item() -> None:
    count, was_reached = 0, True
    while was_reached:
        count += 1
        ready, taken = ReadyItems(), list[int]()
        ready.add([run(1, 3), run(4, 1)])
        was_reached = interrupted_at(count, ready.unpack)
        while ready.items or ready.unpack():
            taken.append(ready.items.popleft().seq)
        assert (taken, bool(ready)) == ([1, 2, 3, 4], False), count
    assert count > 20


def interrupted_at(count: int, call: Callable[[], object]) -> bool:
    """Call `call`, and raise before its bytecode number `count`. Returns whether `call` has this many bytecodes."""
    left = count

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal left
        if frame.f_code.co_filename != ready_items.__file__:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if not left:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def test_items_that_come_again_are_not_new() -> None:
    seen = SeenSeqs()
    assert [item.seq for item in seen.unseen(runs_of([2, 1]))] == [1, 2, 3]
    assert [item.seq for item in seen.unseen([run(2, 3)])] == [4]


def test_after_a_cursor_only_items_that_cannot_come_again_are_forgotten() -> None:
    """After a break, the first cursor of the new stream may lie before items that the reader has got from the former
    stream. In an earlier version the reader got these items twice.
    """
    seen = SeenSeqs()
    seen.unseen([run(1, 5)])  # with the times 10 to 50
    seen.forget_before(6, 30)
    assert [item.seq for item in seen.unseen([run(3, 4)])] == [6]
    seen.forget_before(7, 70)
    assert not seen
    seen.unseen([run(1, 5)])
    seen.forget_before(5, 60)
    assert len(seen) == 1  # accepted after the cursor
