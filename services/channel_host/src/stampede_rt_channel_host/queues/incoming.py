"""Runs as they come from a producer, turned into what the core judges, and its outcome into an ack."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import raw_run_pb2
from stampede_rt.wire.runs import parse_run, seal_run, select_items
from stampede_rt_channel_host.channels.acks import ack_of, refused
from stampede_rt_channel_host.channels.read_ahead import left_nanos
from stampede_rt_channel_host.core.queue import Enqueue


def enqueue_of(message: raw_run_pb2.RawPutRun, producer_id: int, came_s: float) -> Enqueue:
    """The run that came then, not judged yet. Raises MalformedRun, or ItemTooLarge for what no queue can hold."""
    encoded = message.run
    columns = parse_run(encoded)
    items = len(columns.lengths)

    def seal(first_seq: int, places: Sequence[int], stamped_time: int | None) -> bytes:
        kept = encoded if len(places) == items else select_items(encoded, places)
        return seal_run(kept, first_seq, None if stamped_time is None else (stamped_time,) * len(places))

    return Enqueue(
        columns.lengths,
        seal,
        is_stamped=columns.times is None,
        producer_id=producer_id,
        first_number=message.first_number,
        wait_nanos=left_nanos(message.wait_nanos, came_s) if message.HasField("wait_nanos") else None,
    )


def check_number(producer_id: int, first_number: int) -> None:
    """Raises InvalidArgument for a producer that wants its retries recognised and does not count."""
    if producer_id and not first_number:
        raise InvalidArgument("first_number is 0; a producer with an id numbers its items from 1, or leaves its id out")


def answer(run: Enqueue, now: int, incarnation: int) -> pb.PutAck:
    """What became of a run that is through."""
    if run.error is not None:
        return refused(run.first_number, len(run.lengths), run.error, now, incarnation)
    assert run.outcome is not None, "a run that is through has an outcome"
    return ack_of(run.first_number, run.outcome, incarnation)
