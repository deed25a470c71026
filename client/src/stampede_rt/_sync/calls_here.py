# Generated from ../_async by tools/generate.py; do not edit.
"""Puts and gets at the channel host of this process: by reference, without the wire (paper, section 4.1).

Each function returns None if the call must go over the wire: the channel is at another host, or the call may wait for
room, or its answer is long. It also returns None after most failures: the call over the wire then raises the error.
"""

from __future__ import annotations

from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.puts import NumberedPut, accepted
from stampede_rt._sync.session import CALL_TIMEOUT_S, Session
from stampede_rt.cluster.binding import Binding
from stampede_rt.cluster.embedding import InProcessAnswer, InProcessHost, InProcessPut
from stampede_rt.errors import NotArchived, StampedeError
from stampede_rt.transports.concurrency_sync import monotonic_s, result_of, thread_id
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.answers import Items
from stampede_rt.values.model import Ack, Item
from stampede_rt.values.reading import RENEW_S, ReadQuery, Wait
from stampede_rt.wire.records import ack_to_wire


def may_be_here(session: Session, state: ChannelState) -> bool:
    """Whether the channel may be at the host of this process."""
    here = session.here
    if here is None:
        return False
    binding = session.cache.binding(state.info.channel_id, thread_id())
    return binding is None or binding.target == here.target


def end_of_call_s(session: Session, timeout_s: float | None) -> float:
    """Return the time at which a call that may wait for a host must end, by `monotonic_s`.

    `timeout_s` None: the call may wait without a limit. A call on the host's thread that interrupts the host, as
    `__del__` may, must not wait at all: the host would wait, too.
    """
    if session.here is not None and session.here.is_interrupted:
        return monotonic_s()
    return float("inf") if timeout_s is None else monotonic_s() + timeout_s


def newest_here(session: Session, state: ChannelState) -> Item | None:
    """Return the newest item if this process has put it. Waits for nothing."""
    here, binding = session.here, session.cache.binding(state.info.channel_id, thread_id())
    if here is None or binding is None or binding.target != here.target:
        return None
    session.check()
    found = here.newest_now(binding.subject_id, binding.epoch)
    return None if found is None else state.decoder(found.incarnation, payloads=True).decode_here(found.runs)[0]


def at_here(session: Session, state: ChannelState, time: int) -> Items | None:
    """Return the answer to a read at an instant, if the answer is one item that this process put. Waits for nothing."""
    here, binding = session.here, session.cache.binding(state.info.channel_id, thread_id())
    if here is None or binding is None or binding.target != here.target:
        return None
    session.check()
    try:
        answer = here.at_now(binding.subject_id, binding.epoch, time)
    except StampedeError:
        return None
    return None if answer is None else _items(state, answer)


def _binding_here(session: Session, state: ChannelState, here: InProcessHost) -> Binding | None:
    """Return the channel's binding if the channel is at the host of this process."""
    session.check()
    try:
        binding = session.bind(state)
    except StampedeError:
        return None
    return binding if binding.target == here.target else None


def put_here(
    session: Session, state: ChannelState, numbered: NumberedPut, ack: Ack | None, wait: Wait
) -> channel_pb.PutAck | None:
    """Put one item. Returns its ack. Raises TooOld, InFuture, ChannelFull, NotArchived.

    `wait`: the longest wait for the disk. If it is longer than one request may wait, the call over the wire continues
    the wait.
    """
    here = session.here
    binding = None if here is None else _binding_here(session, state, here)
    if here is None or binding is None:
        return None
    item = numbered.item
    wait_s = RENEW_S if wait.seconds is None else min(wait.seconds, RENEW_S)
    put = InProcessPut(
        numbered.producer_id, numbered.number, item.payload, item.time, item.duration, dict(item.attributes),
        item.content_type, ack_to_wire(ack), Wait(wait_s).nanos,
    )  # fmt: skip
    try:
        found = result_of(here.put(binding.subject_id, binding.epoch, put), wait_s + CALL_TIMEOUT_S)
    except (StampedeError, TimeoutError):
        return None
    try:
        return None if found is None else accepted(found)
    except NotArchived as error:
        if wait_s != wait.seconds:
            return None
        error.concerning("channel", state.info.name)
        raise
    except StampedeError as error:
        error.concerning("channel", state.info.name)
        raise


def read_here(session: Session, state: ChannelState, query: ReadQuery) -> Items | None:
    """Return the answer to a read, see `Reader.get`."""
    here = session.here
    may_differ = query.as_of is not None or query.max_staleness_nanos is not None or query.least_seq is not None
    binding = None if here is None or may_differ else _binding_here(session, state, here)
    if here is None or binding is None:
        return None
    wait_s = query.wait.seconds
    try:
        answer = here.read_now(binding.subject_id, binding.epoch, query) if wait_s == 0 else None
        if answer is None:
            limit_s = None if wait_s is None else wait_s + CALL_TIMEOUT_S
            answer = result_of(here.read(binding.subject_id, binding.epoch, query), limit_s)
    except (StampedeError, TimeoutError):
        return None
    if answer is None:
        return None
    return _items(state, answer, payloads=query.payloads, backwards=query.newest_first)


def _items(state: ChannelState, answer: InProcessAnswer, *, payloads: bool = True, backwards: bool = False) -> Items:
    decoder = state.decoder(answer.incarnation, payloads=payloads)
    return Items(
        decoder.decode_here(answer.runs, backwards=backwards),
        interval=answer.interval,
        complete=answer.complete,
        truncated=answer.truncated,
        more=answer.more,
        reason=answer.reason,
        incarnation=answer.incarnation,
    )
