"""Messages that the host frames itself equal the messages that protobuf encodes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import error_pb2, raw_run_pb2
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import parse_interval
from stampede_rt.wire.run_slices import RunSlicer, slice_run
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.channels import frames
from stampede_rt_channel_host.channels.frames import SharedDeliveries, get_error, get_responses
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Offer, Query, ReadAnswer
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES

NOW = 1_700_000_000_000_000_000


def channel_of(lengths: Sequence[int]) -> tuple[ChannelCore, list[bytes]]:
    """A channel with one run for each length, of one item with a label, and the stored bytes."""
    channel, stored = ChannelCore(Policy(max_items=1000), incarnation=9), []
    for place, length in enumerate(lengths):
        time = NOW - 1000 + place

        def seal(first_seq: int, kept: object, stamped: object, time: int = time, length: int = length) -> bytes:
            stored.append(seal_run(encode_run([b"x" * length], times=[time], content_type="x"), first_seq))
            return stored[-1]

        channel.put(Offer(times=[time], durations=None, lengths=[length]), NOW, seal)
    return channel, stored


def read_all(channel: ChannelCore, **fields: object) -> ReadAnswer:
    return channel.read(Query(interval=parse_interval(0, NOW), **fields), NOW)  # type: ignore[arg-type]


@given(st.integers(0, 2**64 - 1), st.lists(st.sampled_from([0, 1, 100, 127, 128, 20_000]), min_size=1, max_size=5))
def test_a_get_response_equals_the_bytes_of_protobuf(call_id: int, lengths: list[int]) -> None:
    channel, stored = channel_of(lengths)
    answer, summary = read_all(channel, limit=len(lengths)), pb.GetSummary(complete=True, detail="why")
    (message,) = get_responses(call_id, answer, summary, without_payloads=False)
    runs = [raw_run_pb2.RawDeliveredRun(run=run) for run in stored]
    expected = raw_run_pb2.RawGetResponse(call_id=call_id, runs=runs, summary=summary)
    assert message.encoded == expected.SerializeToString()
    assert message.payload_bytes == sum(lengths)
    assert message.is_last


def test_only_the_last_run_has_the_time_of_the_next_bucket() -> None:
    channel, _ = channel_of([1, 1, 1])
    (message,) = get_responses(1, read_all(channel, limit=2), pb.GetSummary(), without_payloads=False)
    runs = pb.GetResponse.FromString(message.encoded).runs
    assert [run.HasField("next_time_unix_nano") for run in runs] == [False, True]
    assert runs[1].next_time_unix_nano == NOW - 998


def test_an_answer_is_cut_before_it_exceeds_a_mebibyte() -> None:
    channel, _ = channel_of([400_000] * 5)
    messages = list(get_responses(3, read_all(channel), pb.GetSummary(), without_payloads=False))
    parsed = [pb.GetResponse.FromString(message.encoded) for message in messages]
    assert [len(one.runs) for one in parsed] == [2, 2, 1]
    assert (
        [one.HasField("summary") for one in parsed] == [message.is_last for message in messages] == [False] * 2 + [True]
    )
    assert {one.call_id for one in parsed} == {3}
    assert sum(message.payload_bytes for message in messages) == 2_000_000


def test_an_error_ends_a_call() -> None:
    error = error_pb2.Error(reason=error_pb2.ERROR_REASON_NOT_HERE, message="gone", metadata={"channel": "a"})
    (message,) = get_error(7, error)
    assert pb.GetResponse.FromString(message.encoded) == pb.GetResponse(call_id=7, error=error)
    assert message.is_last


def delivered(lengths: Sequence[int]) -> tuple[Sequence[DeliveredSlice], list[bytes]]:
    """The slices that a reader from the beginning of a new channel gets, and the stored bytes."""
    channel, stored = channel_of(lengths)
    cursor = channel.subscribe_all(NOW, start=parse_interval(0, 0).start)
    return channel.since(cursor, NOW, 10**6).slices, stored


def test_readers_of_the_same_items_share_one_message_until_all_of_them_have_it() -> None:
    slices, stored = delivered([3, 4])
    shared = SharedDeliveries()
    first = shared.encode(slices, b"", without_payloads=False, readers=3)
    assert shared.kept_bytes > len(first.encoded)
    assert shared.encode([*slices], b"", without_payloads=False, readers=3) is first
    assert shared.encode(slices, b"", without_payloads=False, readers=3) is first
    assert (shared.encodings, shared.kept_bytes) == (1, 0)
    assert (first.payload_bytes, first.charge_bytes) == (7, 7 + 2 * ITEM_OVERHEAD_BYTES)
    assert [run.run for run in raw_run_pb2.RawSubscribeResponse.FromString(first.encoded).runs] == stored


def test_a_long_message_has_the_stored_runs_as_parts() -> None:
    slices, stored = delivered([300_000, 18_000])
    delivery = SharedDeliveries().encode(slices, b"", without_payloads=False, readers=1)
    assert delivery.message(takes_parts=True) is delivery.parts
    assert {id(one.slice.run.body) for one in slices} <= {id(part) for part in delivery.parts}
    runs = raw_run_pb2.RawSubscribeResponse.FromString(b"".join(delivery.parts)).runs
    assert [run.run for run in runs] == stored
    joined = b"".join(delivery.parts)
    assert delivery.message(takes_parts=False) == joined


@pytest.mark.parametrize("lengths", [[20_000], [500] * 200])
def test_a_message_that_is_short_or_has_short_parts_is_joined(lengths: list[int]) -> None:
    slices, _ = delivered(lengths)
    delivery = SharedDeliveries().encode(slices, b"", without_payloads=False, readers=1)
    parts, length_bytes = delivery.parts, delivery.length_bytes
    assert delivery.message(takes_parts=True) == b"".join(parts)
    assert [len(part) for part in delivery.parts] == [length_bytes]  # it now keeps the joined message, and no parts


def test_a_message_for_a_single_reader_is_not_kept() -> None:
    slices, _ = delivered([3])
    shared = SharedDeliveries()
    shared.encode(slices, b"", without_payloads=False, readers=1)
    assert shared.kept_bytes == 0


def test_kept_messages_are_bounded_in_bytes_and_the_newest_is_always_kept() -> None:
    shared = SharedDeliveries(bytes_max=100_000)
    small = [delivered([20_000])[0] for _ in range(5)]
    for slices in small:
        shared.encode(slices, b"", without_payloads=False, readers=2)
        assert shared.kept_bytes <= 100_000
    shared.encode(small[-1], b"", without_payloads=False, readers=2)
    assert shared.encodings == 5
    shared.encode(small[0], b"", without_payloads=False, readers=2)
    assert shared.encodings == 6
    large, _ = delivered([200_000])
    first = shared.encode(large, b"", without_payloads=False, readers=3)
    assert shared.encode(large, b"", without_payloads=False, readers=3) is first
    assert 400_000 <= shared.kept_bytes < 410_000  # the message and its run, and nothing else


def test_a_message_for_other_readers_is_encoded_again() -> None:
    slices, stored = delivered([3])
    shared = SharedDeliveries()
    plain = shared.encode(slices, b"", without_payloads=False, readers=2)
    bare = shared.encode(slices, b"", without_payloads=True, readers=2)
    response = pb.SubscribeResponse(gap=pb.SubscriptionGap(first_seq=1, last_seq=2))
    encoded = shared.encode(slices, response.SerializeToString(), without_payloads=False, readers=2)
    assert bare.payload_bytes == 0
    assert bare.charge_bytes == plain.charge_bytes
    parsed = raw_run_pb2.RawSubscribeResponse.FromString(bare.encoded)
    assert parsed.runs[0].run == slice_run(stored[0], 0, 1, without_payloads=True)
    assert len({plain.encoded, bare.encoded, encoded.encoded}) == 3
    assert pb.SubscribeResponse.FromString(encoded.encoded).gap.last_seq == 2


def interleaved(items: int) -> tuple[ChannelCore, list[bytes]]:
    """A channel into which two producers put runs of `items` items. Each item of one lies between two items of the
    other.
    """
    channel, stored = ChannelCore(Policy(max_items=1000), incarnation=9), []
    for odd in (0, 1):
        times = [NOW - 1000 + 2 * at + odd for at in range(items)]
        payloads = [f"{odd}:{at}".encode() for at in range(items)]

        def seal(
            first_seq: int, kept: object, stamped: object, run: bytes = encode_run(payloads, times=times)
        ) -> bytes:
            stored.append(seal_run(run, first_seq))
            return stored[-1]

        channel.put(Offer(times=times, durations=None, lengths=[len(one) for one in payloads]), NOW, seal)
    return channel, stored


def test_a_run_with_interleaved_items_is_parsed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    channel, _ = interleaved(200)
    looked: list[bytes] = []

    class Counting(RunSlicer):
        def __init__(self, sealed: bytes) -> None:
            looked.append(sealed)
            super().__init__(sealed)

    monkeypatch.setattr(frames, "RunSlicer", Counting)
    for without_payloads in (False, True, False):
        messages = get_responses(1, read_all(channel), pb.GetSummary(), without_payloads=without_payloads)
        runs = [run for one in messages for run in pb.GetResponse.FromString(one.encoded).runs]
        assert [run.run.time_unix_nano[0] for run in runs] == [NOW - 1000 + at for at in range(400)]
        found = [run.run.payloads for run in runs]
        assert found == [b"" if without_payloads else f"{at % 2}:{at // 2}".encode() for at in range(400)]
    assert len(looked) == 2


def test_a_message_holds_a_bounded_number_of_runs_however_small_they_are() -> None:
    channel, _ = interleaved(499)
    messages = list(get_responses(1, read_all(channel), pb.GetSummary(), without_payloads=True))
    runs = [len(pb.GetResponse.FromString(message.encoded).runs) for message in messages]
    assert runs == [frames.MESSAGE_RUNS_MAX, 998 - frames.MESSAGE_RUNS_MAX]
    assert [message.is_last for message in messages] == [False, True]


def test_a_large_answer_is_freed_message_by_message_as_it_is_sent() -> None:
    channel, _ = interleaved(500)
    answer = read_all(channel)
    left = [len(answer.slices)]
    for message in get_responses(1, answer, pb.GetSummary(), without_payloads=True):
        assert len(message.encoded) < frames.MESSAGE_BYTES_MAX
        left.append(len(answer.slices))
    assert left == sorted(left, reverse=True)
    assert max(before - after for before, after in pairwise(left)) <= frames.MESSAGE_RUNS_MAX + 256
    assert left[-1] == 0
