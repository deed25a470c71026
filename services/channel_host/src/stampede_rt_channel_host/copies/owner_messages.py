"""Converts the facts of a channel's owner to protobuf (`x_to`) and from it (`x_of`): `OwnerFacts` and `FedPut` in
`replica_service.proto`.

The time of a judgement is a duration on the wire, because the clocks of two hosts differ. Times of items stay instants.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import groupby

from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument
from stampede_rt.status import from_error_message, to_error_message
from stampede_rt.v1 import channel_pb2, channel_service_pb2, subject_pb2
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.channel_status import counters_to
from stampede_rt_channel_host.core.channel import ConsumerPlace, Counters, FedPlaces, GrowingCounts, OwnerPart
from stampede_rt_channel_host.core.dedup import KeptRun, RetryWindow
from stampede_rt_channel_host.core.run_outcome import ItemRefusal, RunOutcome, RunPart


def owner_to(part: OwnerPart, now: int) -> pb.OwnerFacts:
    """The message of a part that has the whole counters. `now`: the owner's clock."""
    assert isinstance(part.counters, Counters), "the part of one put goes to `put_to`"
    return pb.OwnerFacts(
        producers=[_producer_to([*runs], now) for _, runs in groupby(part.runs, lambda run: run.producer_id)],
        consumers=None if part.places is None else _places_to(part.places),
        counters=counters_to(part.counters),
        late=part.counters.late,
        until_unix_nano=part.complete_before,
    )


def owner_of(message: pb.OwnerFacts, now: int) -> OwnerPart:
    """A part, from a message. `now`: the clock of the copy's host. Raises InvalidArgument if it is not valid."""
    return OwnerPart(
        tuple(run for producer in message.producers for run in _runs_of(producer, now)),
        _places_of(message.consumers) if message.HasField("consumers") else None,
        _counters_of(message.counters, message.late),
        message.until_unix_nano if message.HasField("until_unix_nano") else None,
    )


def put_to(part: OwnerPart, now: int) -> pb.FedPut:
    """The message of a part that has only the counters of one put. `now`: the owner's clock."""
    assert isinstance(part.counters, GrowingCounts), "a part with the whole counters goes to `owner_to`"
    (run,) = part.runs
    (accepted,) = run.outcome.parts
    return pb.FedPut(
        producer_id=run.producer_id,
        owner=run.caller_name,
        first_number=run.first_number,
        items=accepted.items,
        first_seq=accepted.first_seq,
        stamped_unix_nano=accepted.stamped_time,
        judged_ago_nanos=max(0, now - run.outcome.time),
        until_unix_nano=part.complete_before,
        accepted=part.counters.accepted,
        accepted_bytes=part.counters.accepted_bytes,
    )


def put_of(message: pb.FedPut, now: int) -> OwnerPart:
    """A part with a `GrowingCounts`, from a message. `now` and errors: as for `owner_of`."""
    items, first_seq = message.items, message.first_seq
    if not (message.producer_id and items and first_seq):
        raise InvalidArgument("the feed has a put without a producer or items; install the same release on both hosts")
    stamp = message.stamped_unix_nano if message.HasField("stamped_unix_nano") else None
    part = RunPart(0, first_seq, items, stamp)
    outcome = RunOutcome(items, items, (part,), (), now - message.judged_ago_nanos)
    run = KeptRun(message.producer_id, message.first_number, outcome, message.owner)
    return OwnerPart((run,), None, GrowingCounts(message.accepted, message.accepted_bytes), message.until_unix_nano)


def retries_to(window: RetryWindow, now: int) -> bytes:
    """The retry window of a channel, encoded for `retries_of`."""
    runs = groupby(window.kept(now), lambda run: run.producer_id)
    return pb.OwnerFacts(
        producers=[_producer_to([*producer_runs], now) for _, producer_runs in runs]
    ).SerializeToString()


def retries_of(encoded: bytes, now: int) -> list[KeptRun]:
    """The runs of a window that `retries_to` has encoded; none if these bytes are damaged."""
    try:
        message = pb.OwnerFacts.FromString(encoded)
        return [run for producer in message.producers for run in _runs_of(producer, now)]
    except (DecodeError, InvalidArgument):
        return []


def _producer_to(runs: list[KeptRun], now: int) -> pb.FedProducer:
    return pb.FedProducer(
        producer_id=runs[0].producer_id,
        owner=runs[0].caller_name,
        runs=[run_to(one.first_number, one.outcome, now) for one in runs],
    )


def run_to(first_number: int, outcome: RunOutcome, now: int) -> pb.FedRun:
    """The message of a run's judgement. `now`: the present time of the clock by which the host has judged the run."""
    return pb.FedRun(
        first_number=first_number,
        items=outcome.items,
        judged_items=outcome.judged_items,
        parts=[
            pb.FedRunPart(index=at, first_seq=seq, items=items, stamped_unix_nano=stamp)
            for at, seq, items, stamp in outcome.parts
        ],
        rejections=[
            channel_service_pb2.PutRejection(index=one.position, error=to_error_message(one.error))
            for one in outcome.refusals
        ],
        judged_ago_nanos=max(0, now - outcome.time),
    )


def _runs_of(producer: pb.FedProducer, now: int) -> Iterator[KeptRun]:
    for run in producer.runs:
        outcome = outcome_of(run, now)
        accepted = sum(one.items for one in outcome.parts)
        if not producer.producer_id or not accepted or accepted + len(run.rejections) != run.judged_items:
            raise InvalidArgument(
                "the feed has a run without a valid judgement; install the same release on both hosts"
            )
        yield KeptRun(producer.producer_id, run.first_number, outcome, producer.owner)


def outcome_of(run: pb.FedRun, now: int) -> RunOutcome:
    """The judgement of a run, from its message. Its time is by the clock that shows `now`."""
    parts = tuple(map(_part_of, run.parts))
    refusals = tuple(ItemRefusal(one.index, from_error_message(one.error)) for one in run.rejections)
    return RunOutcome(run.items, run.judged_items, parts, refusals, now - run.judged_ago_nanos)


def _part_of(message: pb.FedRunPart) -> RunPart:
    stamp = message.stamped_unix_nano if message.HasField("stamped_unix_nano") else None
    return RunPart(message.index, message.first_seq, message.items, stamp)


def _places_to(part: FedPlaces) -> pb.FedConsumers:
    return pb.FedConsumers(begins=part.begins, places=map(_place_to, part.places), ends=part.ends)


def _place_to(place: ConsumerPlace) -> pb.FedConsumer:
    return pb.FedConsumer(
        consumer_id=place.consumer_id,
        lease_nanos=max(0, place.lease_nanos),
        consumed_below_seq=place.consumed_below,
        consumed=[subject_pb2.SeqRange(first_seq=first, items=end - first) for first, end in place.consumed],
        owner=place.caller_name,
    )


def _places_of(message: pb.FedConsumers) -> FedPlaces:
    return FedPlaces(message.begins, tuple(map(_place_of, message.places)), message.ends)


def _place_of(message: pb.FedConsumer) -> ConsumerPlace:
    consumed = tuple((one.first_seq, one.first_seq + one.items) for one in message.consumed)
    return ConsumerPlace(message.consumer_id, message.lease_nanos, message.consumed_below_seq, consumed, message.owner)


def _counters_of(message: channel_pb2.ChannelCounters, late: int) -> Counters:
    return Counters(
        accepted=message.accepted,
        held=message.held,
        collected={
            "age": message.collected_by_age,
            "count": message.collected_by_count,
            "bytes": message.collected_by_bytes,
            "consumption": message.collected_by_consumption,
        },
        rejected={
            "TOO_OLD": message.rejected_too_old,
            "IN_FUTURE": message.rejected_in_future,
            "ITEM_TOO_LARGE": message.rejected_too_large,
            "CHANNEL_FULL": message.rejected_full,
            "MALFORMED_RUN": message.rejected_malformed,
            "OVERLOADED": message.rejected_overloaded,
        },
        accepted_bytes=message.accepted_bytes,
        held_bytes=message.held_bytes,
        late=late,
    )
