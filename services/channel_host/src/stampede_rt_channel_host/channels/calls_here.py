"""Puts and gets of programs in the host's own process: by reference, without the wire (paper, section 4.1).

The objects that a program puts stay in the channel as they are, and gets return them. Other readers get them encoded,
and so does the archive of a recorded channel.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from stampede_rt.cluster.embedding import NO_ATTRIBUTES, InProcessAnswer, InProcessPut, InProcessRun
from stampede_rt.errors import StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.answers import ABSENT
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import Bound, Interval
from stampede_rt.wire.reads import check_item
from stampede_rt.wire.runs import RunColumns, run_parts
from stampede_rt_channel_host.channels.frames import run_bytes, slicer_of
from stampede_rt_channel_host.channels.gets.waiting_get import WaitingGet
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.puts.held_acks import HeldAck
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.puts import check_number
from stampede_rt_channel_host.channels.puts.wanted_acks import check_disk, check_wanted, held_ack
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import (
    ColumnRun,
    Position,
    Query,
    ReadAnswer,
    ReferencedBody,
    Slice,
    UnfinishedWork,
    WakeAt,
    first_of,
)

OnAnswer = Callable[[InProcessAnswer | StampedeError | None], None]


def find_here(store: ChannelStore, channel_id: bytes, epoch: int) -> HostedChannel | None:
    """The channel, if this module serves it; None: it has replicas. Raises the errors of `find`."""
    hosted = store.find(channel_id, epoch)
    return None if hosted.replication is not None else hosted


def put_here(store: ChannelStore, channel_id: bytes, epoch: int, put: InProcessPut) -> pb.PutAck | HeldAck | None:
    """Put one item. Raises the errors of a put.

    Returns None if the channel has replicas, or if the put may have to wait for room. The caller then uses a stream.
    """
    hosted, received_s = find_here(store, channel_id, epoch), time.monotonic()
    if hosted is None or hosted.puts.may_wait:
        return None
    check_number(put.producer_id, put.number)
    check_wanted(hosted, put.ack)
    times = None if put.time is None else (put.time,)
    durations = None if put.duration is None else (put.duration,)
    parts = run_parts(
        (put.payload,), times=times, durations=durations, content_type=put.content_type, attributes=put.attributes
    )
    run = IncomingRun(
        ReferencedBody(parts, put.payload, put.attributes, put.content_type),
        columns=RunColumns(times, durations, (len(put.payload),)),
        producer_id=put.producer_id,
        first_number=put.number,
        wait_nanos=0,
    )
    return held_ack(put_now(hosted, run, put.ack, store.now()), hosted, put, received_s)


def put_now(hosted: HostedChannel, run: IncomingRun, wanted: int, now: int) -> pb.PutAck:
    """Put a run that surely need not wait for room. `wanted`: a number of the enum Ack. Raises the errors of a put."""
    if hosted.recording is not None:
        check_disk(hosted, wanted, is_repeated=hosted.puts.repeats(run, now))
    ack = hosted.puts.put(run, now)
    assert ack is not None, "the channel lets no put wait"
    return ack


def read_now(store: ChannelStore, channel_id: bytes, epoch: int, query: ReadQuery) -> InProcessAnswer | None:
    """The answer to a read. Changes no item.

    None if the channel has replicas, if the read would have to free old items first, if the archive may have items of
    the answer, or if the read is long. The caller holds the turn of the loop. Raises the errors of a get.
    """
    hosted, now = find_here(store, channel_id, epoch), store.now()
    if hosted is None or (hosted.due is not None and hosted.due <= now):
        return None
    core_query = query_of(query)
    if _reads_archive(hosted, query, core_query, now):
        return None
    found = first_of(hosted.channel.reading(core_query, now))
    return None if isinstance(found, UnfinishedWork) else _in_process_answer(hosted, found, payloads=query.payloads)


def at_now(store: ChannelStore, channel_id: bytes, epoch: int, instant: int) -> InProcessAnswer | None:
    """The answer to a read at an instant, if the answer is one item. Changes nothing.

    If it returns None, call `read_now`. The caller holds the turn of the loop. Raises the errors of a get.
    """
    hosted, now = find_here(store, channel_id, epoch), store.now()
    if hosted is None or (hosted.due is not None and hosted.due <= now):
        return None
    if hosted.recording is not None:
        bound = Bound(None, instant)
        if hosted.recording.reaches(Query(interval=Interval(bound, bound)), now):
            return None
    found = hosted.channel.at(instant, now)
    return None if found is None else _single_slice_answer(hosted, found)


def newest_now(store: ChannelStore, channel_id: bytes, epoch: int) -> InProcessAnswer | None:
    """The answer to a read of the newest item. Changes nothing.

    If it returns None, call `read_now`, which also finds the reason of a failure. The caller holds the turn of the
    loop.
    """
    try:
        hosted = find_here(store, channel_id, epoch)
    except StampedeError:
        return None
    is_due = hosted is None or (hosted.due is not None and hosted.due <= store.now())
    if hosted is not None and hosted.recording is not None and not hosted.recording.is_past_known:
        return None
    part = None if hosted is None or is_due else next(iter(hosted.channel.newest_slices()), None)
    if hosted is None or part is None:
        return None
    newest = Slice(part.run, part.hi - 1, part.hi)
    hosted.count_delivered(1, newest.payload_bytes)
    run = _run(newest, None, payloads=True)
    return InProcessAnswer((run,), None, False, False, False, None, hosted.channel.incarnation)


def read_here(
    store: ChannelStore, channel_id: bytes, epoch: int, query: ReadQuery, on_answer: OnAnswer
) -> WaitingGet | None:
    """Perform a get on the loop, and call `on_answer` with its answer. Returns the get if it waits.

    `on_answer` gets None if the channel has replicas, if the answer is long, or if the archive may have a part of it.
    The caller then uses a stream. Raises the errors of a get.
    """
    hosted, now = find_here(store, channel_id, epoch), store.now()
    core_query = query_of(query)
    if hosted is None or _reads_archive(hosted, query, core_query, now):
        on_answer(None)
        return None
    if query.wait.seconds == 0:
        found = first_of(hosted.channel.reading(core_query, now))
        if isinstance(found, UnfinishedWork):
            on_answer(None)
        else:
            on_answer(_in_process_answer(hosted, found, payloads=query.payloads))
        return None
    pending = hosted.channel.begin(core_query, now)
    polled = first_of(hosted.channel.polling(pending, now))

    def outcome(found: object) -> None:
        if isinstance(found, StampedeError):
            on_answer(found)
        elif isinstance(found, ReadAnswer):
            on_answer(_in_process_answer(hosted, found, payloads=query.payloads))
        else:
            on_answer(None)

    if isinstance(polled, WakeAt):
        return hosted.gets.add(pending, polled, query.wait.nanos, now, outcome)
    outcome(polled)
    return None


def _reads_archive(hosted: HostedChannel, query: ReadQuery, core_query: Query, now: int) -> bool:
    """Whether the answer may have items that only the archive has. Such a read goes over a stream."""
    recording = hosted.recording
    return recording is not None and not query.within_memory and recording.reaches(core_query, now)


def query_of(query: ReadQuery) -> Query:
    """The query of the core. Raises InvalidArgument for an item that was not read from a channel."""
    return Query(
        interval=query.interval,
        match=query.match,
        limit=query.limit,
        newest_first=query.newest_first,
        after=_position(query.after),
        newer_than=_position(query.newer_than),
        complete=query.complete,
    )


def _position(after: Item | int | None) -> Position | None:
    if after is None:
        return None
    if isinstance(after, Item):
        check_item(after)
        return Position(after.time, after.seq, after.incarnation)
    return Position(after, None, 0)


def _in_process_answer(hosted: HostedChannel, answer: ReadAnswer, *, payloads: bool = True) -> InProcessAnswer:
    slices = [*answer.slices]
    ends = [answer.next_times.get((part.last_time, part.end_seq)) for part in slices[:-1]]
    runs = [_run(part, end, payloads=payloads) for part, end in zip(slices, [*ends, answer.next_time], strict=False)]
    hosted.count_delivered(sum(part.items for part in slices), sum(part.payload_bytes for part in slices))
    return InProcessAnswer(
        runs=runs, interval=answer.interval, complete=answer.complete, truncated=answer.truncated, more=answer.more,
        reason=answer.reason, incarnation=answer.incarnation,
    )  # fmt: skip


def _single_slice_answer(hosted: HostedChannel, answer: ReadAnswer) -> InProcessAnswer:
    """Do the same as `_in_process_answer`, for an answer of one slice."""
    part = answer.slices[0]
    hosted.count_delivered(part.items, part.payload_bytes)
    run = _run(part, answer.next_time, payloads=True)
    return InProcessAnswer(
        (run,), answer.interval, answer.complete, answer.truncated, answer.more, answer.reason, answer.incarnation
    )


def _run(part: Slice, next_time: int | None, *, payloads: bool) -> InProcessRun:
    run = part.run
    body, payload, attributes, content_type = run.body, None, NO_ATTRIBUTES, ""
    if isinstance(body, ReferencedBody):
        payload, attributes, content_type = body.payload, body.attributes, body.content_type
    elif payloads and part.hi - part.lo == 1 and isinstance(run, ColumnRun):
        payload = slicer_of(run).plain_payload(part.lo)
    if payload is None:
        return InProcessRun(encoded=run_bytes(part, without_payloads=not payloads), next_time=next_time)
    durations = run.durations
    return InProcessRun(
        part.first_time,
        ABSENT if durations is None else durations[part.lo],
        part.first_seq,
        len(payload),
        payload if payloads else None,
        attributes,
        content_type,
        next_time,
    )
