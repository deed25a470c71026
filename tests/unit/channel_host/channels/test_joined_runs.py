"""Runs of one item that follow each other become one run, and the reader gets the same items."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

from hypothesis import given, strategies

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import item_pb2
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import parse_interval
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.plain_runs import plain_run_parts
from stampede_rt.wire.runs import RUN_BYTES_MAX, encode_run, seal_run
from stampede_rt_channel_host.channels.frames import get_responses
from stampede_rt_channel_host.channels.joined_runs import (
    ITEM_BYTES_MAX,
    joined_deliveries,
    joined_runs,
    joined_slices,
)
from stampede_rt_channel_host.copies.messages import run_of
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Offer, Query, ReferencedBody, Run, Slice
from stampede_rt_channel_host.core.channel.run import SingleItemRun


class Put(NamedTuple):
    """One put: of several items, or of one item with unusual fields."""

    step: int = 1
    skipped: int = 0
    items: int = 1
    length: int = 3
    duration: int | None = None
    is_stamped: bool = False
    content_type: str = ""
    is_referenced: bool = False


puts = strategies.builds(
    Put,
    step=strategies.integers(-1, 2),
    skipped=strategies.sampled_from([0, 0, 0, 1]),
    items=strategies.sampled_from([1, 1, 1, 2]),
    length=strategies.sampled_from([0, 3, 127, 128, ITEM_BYTES_MAX, ITEM_BYTES_MAX + 1]),
    duration=strategies.sampled_from([None, None, -1, 5]),
    is_stamped=strategies.booleans(),
    content_type=strategies.sampled_from(["", "", "", "a/bcdefg"]),  # ten bytes with its tag, like a column
    is_referenced=strategies.booleans(),
)


def stored(put: Put, seq: int, time: int) -> Run:
    """The run that a host stores."""
    payloads = [b"%d" % (at % 10) * put.length for at in range(put.items)]
    times, durations = [time] * put.items, None if put.duration is None else [put.duration] * put.items
    encoded = encode_run(
        payloads, times=None if put.is_stamped else times, durations=durations, content_type=put.content_type
    )
    run = run_of(seal_run(encoded, seq, times if put.is_stamped else None))
    if put.is_referenced and put.items == 1 and not put.content_type:
        parts = plain_run_parts(payloads[0], time, put.duration)
        run.body = ReferencedBody(parts, payloads[0], {}, "").followed_by(seal_run(b"", seq))
    return run


def all_stored(given_puts: list[Put]) -> list[Run]:
    runs, seq, time = list[Run](), 1, 100
    for put in given_puts:
        seq, time = seq + put.skipped, time + put.step
        runs.append(stored(put, seq, time))
        seq += put.items
    return runs


def items_of(runs: list[Run]) -> list[object]:
    """All fields of the items, except the ends of their spans."""
    decoder = ItemDecoder(incarnation=1, content_type="of/the-channel", payloads=True)
    delivered = [item_pb2.DeliveredRun(run=item_pb2.ItemRun.FromString(bytes(run.body))) for run in runs]
    return [one[:1] + one[2:] for each in decoder.decode_each(delivered) for one in each]


@given(strategies.lists(puts, max_size=12))
def test_joined_runs_have_the_same_items_and_columns(given_puts: list[Put]) -> None:
    runs = all_stored(given_puts)
    joined = joined_runs(runs)
    assert items_of(joined) == items_of(runs)
    for run in joined:
        reread = run_of(bytes(run.body))
        assert (reread.first_seq, [*reread.times], [*reread.lengths]) == (run.first_seq, [*run.times], [*run.lengths])
        assert (reread.durations and [*reread.durations]) == (run.durations and [*run.durations])
        if len(run) > 1:
            assert [*run.times] == sorted(run.times)
    for one, other in pairwise(joined):
        assert not (may_join(one) and may_join(other) and follows(one, other)), "the two would have been joined"


def may_join(run: Run) -> bool:
    parsed = item_pb2.ItemRun.FromString(bytes(run.body))
    return isinstance(run, SingleItemRun) and not parsed.content_type and run.length <= ITEM_BYTES_MAX


def follows(one: Run, other: Run) -> bool:
    return other.first_seq == one.first_seq + 1 and other.times[0] >= one.times[0]


def test_a_joined_run_is_no_longer_than_a_producers_run() -> None:
    joined = joined_runs(all_stored([Put()] * (2 * RUN_ITEMS_MAX + 1)))
    assert [len(run) for run in joined] == [RUN_ITEMS_MAX, RUN_ITEMS_MAX, 1]
    joined = joined_runs(all_stored([Put(length=ITEM_BYTES_MAX)] * 60))
    assert [len(run) for run in joined] == [RUN_BYTES_MAX // ITEM_BYTES_MAX, 60 - RUN_BYTES_MAX // ITEM_BYTES_MAX]


def test_slices_end_at_the_ends_that_the_caller_gives_and_count_the_stored_runs() -> None:
    runs = all_stored([Put(), Put(), Put(), Put(items=2), Put()])
    slices = [Slice(run, 0, len(run)) for run in runs]
    found = [(part.items, count) for part, count in joined_slices(slices, ends={(102, 3)})]
    assert found == [(2, 2), (1, 1), (2, 1), (1, 1)]


def subscribed(given_puts: list[Put], overlap: int | None) -> list[DeliveredSlice]:
    """The slices that a subscription from the beginning gets at the end of all puts."""
    channel, time = ChannelCore(Policy(max_items=1000, overlap_nanos=overlap), incarnation=9), 100
    cursor = channel.subscribe_all(1000, start=parse_interval(0, 0).start)
    for put in given_puts:
        time += put.step
        durations = None if put.duration is None else [put.duration] * put.items
        offer = Offer(times=[time] * put.items, durations=durations, lengths=[put.length] * put.items)
        channel.put(offer, 1000, lambda seq, *_, put=put, time=time: bytes(stored(put, seq, time).body))
    return [*channel.since(cursor, 1000, 10**9).slices]


def received(slices: Iterable[DeliveredSlice]) -> list[object]:
    """The items of a subscription's messages, with the ends of their spans."""
    decoder = ItemDecoder(incarnation=9, content_type="", payloads=True)
    runs = [
        item_pb2.DeliveredRun(run=item_pb2.ItemRun.FromString(bytes(part.run.body)), next_time_unix_nano=next_time)
        for part, next_time in slices
    ]
    return [one for each in decoder.decode_each(runs) for one in each]


@given(strategies.lists(puts, max_size=12), strategies.sampled_from([None, 3]))
def test_a_subscription_has_the_same_items_and_spans_with_joined_runs(
    given_puts: list[Put], overlap: int | None
) -> None:
    slices = subscribed(given_puts, overlap)
    assert received(joined_deliveries(slices)) == received(slices)


def test_a_batch_of_single_puts_becomes_one_run() -> None:
    slices = subscribed([Put()] * 600, None)
    assert len(slices) == 256
    assert [(part.items, next_time) for part, next_time in joined_deliveries(slices)] == [(256, 357)]
    late = subscribed([Put(step=10), Put(step=10), Put(step=-5), Put(step=20)], None)  # at 110, 120, 115, 135
    assert [next_time for _, next_time in joined_deliveries(late)] == [115, 135, 120, None]


def test_a_get_of_single_puts_has_few_runs_with_and_without_payloads() -> None:
    channel = ChannelCore(Policy(max_items=1000), incarnation=9)
    for time in range(100, 700):

        def seal(first_seq: int, kept: object, stamped: object, time: int = time) -> bytes:
            return seal_run(encode_run([b"%d" % time], times=[time]), first_seq)

        channel.put(Offer(times=[time], durations=None, lengths=[3]), 700, seal)
    for without_payloads in (False, True):
        answer = channel.read(Query(interval=parse_interval(0, 700)), 700)
        messages = [*get_responses(1, answer, pb.GetSummary(), without_payloads=without_payloads)]
        runs = [one.run for message in messages for one in pb.GetResponse.FromString(message.encoded).runs]
        assert [len(run.time_unix_nano) for run in runs] == [256, 256, 88]
        assert b"".join(run.payloads for run in runs) == (
            b"" if without_payloads else b"".join(b"%d" % time for time in range(100, 700))
        )
        assert sum(message.items for message in messages) == 600
