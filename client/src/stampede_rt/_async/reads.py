"""Reads: the client sends a request on the open stream to the channel's host, and makes Items of the answer."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.copies import copy_for_gets, may_succeed_at_owner, note_refusal
from stampede_rt._async.session import CALL_TIMEOUT_S, Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import StampedeError, VersionMismatch
from stampede_rt.status import from_error_message
from stampede_rt.transports.concurrency_async import monotonic_s
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.answers import Items
from stampede_rt.values.grouping import SeenCut
from stampede_rt.values.model import Reason
from stampede_rt.values.pages import Pages
from stampede_rt.values.reading import RENEW_S, ReadQuery, Wait
from stampede_rt.values.timeline import ResolvedInterval, fixed
from stampede_rt.wire.reads import (
    interval_to_message,
    match_to_message,
    past_from_message,
    position_of,
    resolved_from_message,
    summary_reason,
)

COPY_TIMEOUT_S = 2.0  # after the wait of the read and this time, the client gives up a copy that has not answered
# With these reasons, items may still come into the interval. LOST: the producer may put the lost items again.
_MAY_COME = (Reason.NOT_YET, Reason.HIDDEN, Reason.LOST)


async def read(session: Session, state: ChannelState, query: ReadQuery, view: SeenCut | None = None) -> Items:
    """Perform `query`, even if the channel has moved to another host.

    Blocks for the wait of the query, and for at most 10 s more. `view`: the group through which to read. The client
    sends the highest cut that it has seen in this group, and notes the cut of the answer. The client splits a wait
    without limit into several requests, so that it notices a host that hangs. All of these requests use the interval as
    the host first resolved it.
    """
    if query.wait.seconds is not None:
        return await _read_once(session, state, query, view)
    while True:
        items = await _read_once(session, state, query, view)
        if items.complete or (items and not query.complete) or items.reason not in _MAY_COME:
            return items
        query = replace(query, interval=fixed(query.interval, items.interval))


async def read_as_of(
    session: Session, state: ChannelState, query: ReadQuery, as_of: int, view: SeenCut | None = None
) -> Items:
    """Perform `query` as of an instant. Raises VersionMismatch if the host does not know the past."""
    items = await read(session, state, replace(query, as_of=as_of), view)
    if items.past is None:
        raise VersionMismatch(f"the host of channel {state.info.name!r} does not know as_of; upgrade the host")
    return items


async def _read_once(session: Session, state: ChannelState, query: ReadQuery, view: SeenCut | None) -> Items:
    """Perform one request. If the query waits without a limit, the request waits for RENEW_S."""
    wait_s = RENEW_S if query.wait.seconds is None else query.wait.seconds
    began_s = monotonic_s()

    async def read_at(binding: Binding, timeout_s: float) -> Items:
        nonlocal query
        exchange = session.endpoints.to(binding.target).gets()
        wait = Wait(wait_s).after(monotonic_s() - began_s)
        try:
            responses = await exchange.get(_request(binding, query, wait, view), timeout_s)
            pages = Pages(query, _answer(state, query, responses))
            while responses[-1].summary.continues:
                rest = pages.rest
                responses = await exchange.get(_request(binding, rest, Wait(0), view), CALL_TIMEOUT_S)
                pages.add(_answer(state, rest, responses))
        except StampedeError as error:
            query = replace(query, interval=fixed(query.interval, _interval_of(error)))
            raise
        items = pages.whole
        if view is not None:
            view.note_cut(items.cut)
        return items

    if query.max_staleness_nanos is not None or query.least_seq is not None:
        copy = await copy_for_gets(session, state)
        if copy is not None:
            try:
                return await read_at(copy, wait_s + COPY_TIMEOUT_S)
            except StampedeError as error:
                if not may_succeed_at_owner(error):
                    raise
                note_refusal(session, state, error)
    return await session.perform(state, read_at, began_s + wait_s + CALL_TIMEOUT_S - monotonic_s())


def _request(binding: Binding, query: ReadQuery, wait: Wait, view: SeenCut | None) -> channel_pb.GetRequest:
    return channel_pb.GetRequest(
        channel_id=binding.subject_id,
        epoch=binding.epoch,
        interval=interval_to_message(query.interval),
        match=match_to_message(query.match),
        limit=query.limit,
        newest_first=query.newest_first,
        after=None if query.after is None else position_of(query.after),
        newer_than=None if query.newer_than is None else position_of(query.newer_than),
        without_payloads=not query.payloads,
        wait_nanos=wait.nanos,
        complete=query.complete,
        group_id=view.group_id if view else None,
        cut_floor_unix_nano=view.cut_floor if view else None,
        cut_unix_nano=query.cut,
        max_staleness_nanos=query.max_staleness_nanos,
        least_seq=query.least_seq,
        within_memory=query.within_memory,
        as_of_unix_nano=query.as_of,
        now_unix_nano=query.now,
    )


def _interval_of(error: StampedeError) -> ResolvedInterval | None:
    """Return the interval as a host had resolved it before the channel moved away; None if the error has none."""
    start, end = error.metadata.get("start_unix_nano"), error.metadata.get("end_unix_nano")
    return None if start is None or end is None else ResolvedInterval(int(start), int(end))


def _answer(state: ChannelState, query: ReadQuery, responses: list[channel_pb.GetResponse]) -> Items:
    last = responses[-1]
    if last.HasField("error"):
        raise from_error_message(last.error)
    summary = last.summary
    decoder = state.decoder(summary.incarnation, payloads=query.payloads)
    runs = [run for response in responses for run in response.runs]
    return Items(
        decoder.decode(runs, backwards=query.newest_first),
        interval=resolved_from_message(summary.interval) if summary.HasField("interval") else None,
        complete=summary.complete,
        truncated=summary.truncated,
        more=summary.more,
        reason=summary_reason(summary),
        incarnation=summary.incarnation,
        cut=summary.cut_unix_nano if summary.HasField("cut_unix_nano") else None,
        past=past_from_message(summary.past) if summary.HasField("past") else None,
        staleness_nanos=summary.staleness_nanos if summary.HasField("staleness_nanos") else None,
    )
