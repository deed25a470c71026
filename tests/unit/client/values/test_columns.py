"""Columns hold the same items as a list, and make an `Item` only when the program touches it."""

from __future__ import annotations

import pickle
from array import array
from collections.abc import Iterable, Sequence
from itertools import accumulate, pairwise
from threading import Barrier, Thread
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies

import stampede_rt as st
from stampede_rt.values.answers import Items
from stampede_rt.values.columns import DecodedRun, ItemColumns, kept, span_end, span_ends
from stampede_rt.values.model import Item

RUN = strategies.lists(
    strategies.tuples(strategies.integers(0, 20), strategies.integers(-1, 9), strategies.binary(max_size=3)),
    min_size=1,
    max_size=5,
)


def decoded(items: Sequence[tuple[int, int, bytes]], first_seq: int = 1, *, payloads: bool = True) -> DecodedRun:
    durations = array("q", [duration for _, duration, _ in items])
    return DecodedRun(
        times=array("q", [time for time, _, _ in items]),
        durations=durations if any(one >= 0 for one in durations) else None,
        lengths=array("I", [len(payload) for _, _, payload in items]),
        first_seq=first_seq,
        attributes={"k": "v"},
        content_type="text/plain",
        incarnation=7,
        payloads=b"".join(payload for _, _, payload in items) if payloads else None,
    )


class ItemCounter:
    """Makes items, and counts them."""

    def __init__(self) -> None:
        self.made = 0

    def __call__(self, fields: Iterable[Any]) -> Item:
        self.made += 1
        return Item._make(fields)


def columns(runs: Sequence[DecodedRun], **rest: Any) -> ItemColumns:
    runs[-1].next_time = rest.pop("next_time", None)
    return ItemColumns(runs, overlap=rest.pop("overlap", 0), **rest)


def expected(runs: Sequence[DecodedRun], next_time: int | None, overlap: int) -> list[Item]:
    """All items, each made without the columns."""
    flat = [
        (time, -1 if run.durations is None else run.durations[at], run.seqs[at], run, at)
        for run in runs
        for at, time in enumerate(run.times)
    ]
    items = []
    for number, (time, duration, seq, run, at) in enumerate(flat):
        later = [other for other, *_ in flat[number + 1 :] if other > time]
        following = later[0] if later else next_time if next_time is not None and next_time > time else None
        begin, end = [*pairwise(accumulate(run.lengths, initial=0))][at]
        payload = None if run.payloads is None else run.payloads[begin:end]
        given_duration = None if duration < 0 else duration
        end_time = span_end(time, duration, following, overlap)
        items.append(Item(time, end_time, given_duration, seq, payload, {"k": "v"}, "text/plain", run.lengths[at], 7))
    return items


@given(
    strategies.lists(RUN, min_size=1, max_size=4),
    strategies.none() | strategies.integers(0, 30),
    strategies.sampled_from([0, 4]),
    strategies.booleans(),
    strategies.booleans(),
)
def test_columns_hold_the_same_items_as_a_list(
    runs: list[list[tuple[int, int, bytes]]], next_time: int | None, overlap: int, payloads: bool, backwards: bool
) -> None:
    flat = sorted(item for run in runs for item in run)  # the answer of a get is in the order of time
    parts = [decoded([flat.pop(0) for _ in run], 1 + 100 * at, payloads=payloads) for at, run in enumerate(runs)]
    whole = expected(parts, next_time, overlap)[:: -1 if backwards else 1]
    found = columns(parts, next_time=next_time, overlap=overlap, backwards=backwards)
    touched = [found[at] for at in range(-len(whole), len(whole), 2)]
    assert touched == [whole[at] for at in range(-len(whole), len(whole), 2)]
    for part in (slice(None), slice(1, None), slice(0, 1), slice(None, None, -1), slice(-2, 100), slice(5, 2)):
        assert found[part] == whole[part]
    assert [*found] == whole
    assert [*found.column("time")] == [item.time for item in whole]
    assert [*found.column("seq")] == [item.seq for item in whole]
    assert [*found.column("duration")] == [-1 if item.duration is None else item.duration for item in whole]
    for outside in (len(whole), -len(whole) - 1):
        with pytest.raises(IndexError):
            found[outside]


def test_a_run_that_is_not_followed_by_the_next_bucket_states_the_end_of_its_spans() -> None:
    first, second = decoded([(1, -1, b""), (2, -1, b""), (2, 30, b"")]), decoded([(9, -1, b"")], 7)
    first.next_time = 5
    assert [item.end for item in columns([first, second], next_time=12)] == [2, 5, 5, 12]
    assert [item.end for item in columns([first, second], overlap=9)] == [2, 5, 11, None]


def test_an_item_object_is_created_on_first_access() -> None:
    make = ItemCounter()
    parts = [decoded([(time, -1, b"x") for time in range(begin, begin + 100)], begin + 1) for begin in (0, 100, 200)]
    found = columns(parts, make=make)
    assert (len(found), make.made) == (300, 0)
    assert [*found.column("time")] == [*range(300)]
    assert make.made == 0
    item = found[150]
    assert (item.time, make.made) == (150, 1)
    assert found[150] is item
    assert make.made == 1
    assert [one.seq for one in found[10:13]] == [11, 12, 13]
    assert make.made == 4
    assert [*found][150] is item, "the columns keep the item, because a program may have decoded its value"
    before = make.made
    assert [*found][150] is item
    assert make.made == before


def test_payloads_are_kept_only_once_after_all_item_objects_are_created() -> None:
    run = decoded([(1, -1, b"one"), (2, -1, b"two")])
    found = columns([run])
    assert found[1].payload == b"two"
    assert run.payloads == b"onetwo"
    assert [item.payload for item in found] == [b"one", b"two"]
    assert run.payloads is None
    assert found[0].payload == b"one"


def test_threads_that_access_the_same_items_get_equal_objects() -> None:
    for _ in range(20):
        found = columns([decoded([(time, -1, b"%d" % time) for time in range(250)])])
        whole, begin, results = [b"%d" % time for time in range(250)], Barrier(3), list[list[bytes | None]]()

        def one_by_one(found: ItemColumns = found, begin: Barrier = begin, results: list[Any] = results) -> None:
            begin.wait()
            results.append([found[at].payload for at in range(250)])

        def in_one_iteration(found: ItemColumns = found, begin: Barrier = begin, results: list[Any] = results) -> None:
            begin.wait()
            results.append([item.payload for item in found])

        threads = [Thread(target=one) for one in (one_by_one, in_one_iteration, one_by_one)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert results == [whole] * 3


def answer(items: Sequence[Item]) -> Items:
    return st.Items(
        items, interval=None, complete=False, truncated=False, more=False, reason=None, incarnation=7, cut=None
    )


@pytest.mark.parametrize("as_list", [False, True])
def test_an_answer_shows_its_columns_and_numpy_views_them_without_a_copy(as_list: bool) -> None:
    found: Sequence[Item] = columns([decoded([(10, 5, b"x"), (20, -1, b"y")], 3)])
    items = answer([*found] if as_list else found)
    assert (items.times.tolist(), items.durations.tolist(), items.seqs.tolist()) == ([10, 20], [5, -1], [3, 4])
    times, seqs = items.times, np.asarray(items.seqs)
    view = np.asarray(times)
    assert (view.dtype, seqs.dtype) == (np.int64, np.uint64)
    assert np.shares_memory(view, np.frombuffer(times, dtype=np.int64))
    with pytest.raises(TypeError):
        times[0] = 1
    assert not view.flags.writeable


def test_an_empty_answer_has_empty_columns() -> None:
    assert (len(answer([]).times), [*answer([])]) == (0, [])


def test_an_answer_can_be_pickled() -> None:
    items = answer(columns([decoded([(10, 5, b"x"), (20, -1, b"y")], 3)]))
    unpickled = pickle.loads(pickle.dumps(items))
    assert [*unpickled] == [*items]
    assert unpickled.times.tolist() == [10, 20]


def test_late_items_do_not_end_the_spans_of_later_items() -> None:
    assert span_ends([5, 3, 9], None, None, 0) == [9, 9, None]
    assert span_ends([5, 6], None, 6, 0) == [6, None]


def test_items_of_the_same_time_end_with_the_next_bucket() -> None:
    assert span_ends([5, 5, 5], None, 8, 0) == [8, 8, 8]
    assert span_ends([5, 5, 5], None, None, 0) == [None, None, None]
    assert span_ends([5, 5, 5], [1, -1, 9], 8, 0) == [6, 8, 8]
    assert span_ends([5, 5, 5], [1, -1, 9], None, 0) == [6, None, 14]


@given(
    strategies.lists(RUN, min_size=1, max_size=3),
    strategies.lists(strategies.integers(0, 14), max_size=3),
    strategies.booleans(),
    strategies.booleans(),
)
def test_the_column_of_payloads_has_the_payloads_of_the_items(
    runs: list[list[tuple[int, int, bytes]]], touched: list[int], backwards: bool, as_lists: bool
) -> None:
    made = [decoded(run) for run in runs]
    if as_lists:
        for one, run in zip(made, runs, strict=True):
            one.payloads = [payload for _, _, payload in run]
    found = columns(made, backwards=backwards)
    wanted = [payload for run in runs for _, _, payload in run]
    wanted = wanted[::-1] if backwards else wanted
    for at in touched:
        assert found[at % len(found)].payload == wanted[at % len(found)]
    assert found.payload_list() == wanted
    assert [item.payload for item in found] == wanted
    assert found.payload_list() == wanted
    assert found.payload_bytes == sum(map(len, wanted))


def test_items_that_were_read_without_payloads_have_none_in_the_column() -> None:
    assert columns([decoded([(1, -1, b"a"), (2, -1, b"b")], payloads=False)]).payload_list() == [None, None]


@pytest.mark.parametrize("length", [3, 2000])
def test_payloads_of_a_view_are_copied(length: int) -> None:
    room = bytearray(b"a" * length + b"b" * length)
    run = decoded([(10, -1, b"a" * length), (20, -1, b"b" * length)], 3)
    run.payloads = memoryview(room)
    items = columns([kept(run)])
    room[:] = bytes(2 * length)
    assert [item.payload for item in items] == [b"a" * length, b"b" * length]
    assert {type(item.payload) for item in items} == {bytes}
