"""The blocking producer against a stream whose acks another thread brings."""

from __future__ import annotations

import threading
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, cast

import pytest

import stampede_rt as st
from stampede_rt._sync import producer as producer_module
from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.producer import IN_FLIGHT_BYTES_MAX, Producer
from stampede_rt._sync.session import Session
from stampede_rt.cluster.binding import Binding, BindingCache
from stampede_rt.status import from_error_message, to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.wire.batching import UnackedRuns

LIMIT_S = 5.0


class OneChannelSession:
    """A session with one channel at one host, and the stream to that host."""

    closed = inherited = False
    here: Any = None

    def __init__(self) -> None:
        self.cache, self.endpoints = BindingCache(), self
        self.on_response: Any = None
        self.streams = 0
        self.errors: list[BaseException] = []  # the errors of the next sends

    def check_process(self) -> None:
        return

    def to(self, target: str) -> OneChannelSession:
        return self

    def duplex(self, on_response: Any, on_end: Any) -> OneChannelSession:
        self.on_response = on_response
        self.streams += 1
        return self

    def send(self, request: bytes | list[bytes]) -> None:
        if self.errors and isinstance(request, list):
            raise self.errors.pop()
        if isinstance(request, list) and self.streams > 1:
            self.on_response(pb.PutResponse(acks=[pb.PutAck(first_number=1, items=1)]))

    def cancel(self) -> None:
        return

    def perform(self, state: ChannelState, operation: Any, timeout_s: float = 10.0) -> Any:
        return operation(Binding(subject_id=b"c", target="there", epoch=1, incarnation=1), timeout_s)


class WatchedRuns(UnackedRuns):
    """The unacknowledged runs. Its `len` first calls the next function of `looks`."""

    looks: list[Any] | None = None

    def __len__(self) -> int:
        if self.looks:
            self.looks.pop(0)()
        return super().__len__()


def producer_of(session: OneChannelSession) -> Producer:
    info = ChannelInfo.__new__(ChannelInfo)
    object.__setattr__(info, "channel_id", b"c")
    object.__setattr__(info, "name", "cam/left")
    return Producer(cast(Session, session), ChannelState(info, cast(Policy, None), True))


def refused() -> pb.PutAck:
    """The ack of the first run, whose only item is refused."""
    error = to_error_message(st.InvalidArgument("not this one"))
    return pb.PutAck(first_number=1, items=1, rejections=[pb.PutRejection(error=error)])


def test_a_flush_raises_the_refusal_that_another_thread_counts_while_the_flush_looks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, the flush returned between the end of the last run and the count of its refusals."""
    session = OneChannelSession()
    producer = producer_of(session)
    unacked = producer._unacked = WatchedRuns()
    producer.put(b"x")
    has_reported, flushed = threading.Event(), threading.Event()

    def slow(error: Any) -> st.StampedeError:
        has_reported.set()
        flushed.wait(0.2)
        return from_error_message(error)

    def set_signal() -> None:
        session.on_response(pb.PutResponse(acks=[refused()]))
        has_reported.set()

    def looked() -> None:
        threading.Thread(target=set_signal).start()
        assert has_reported.wait(LIMIT_S)

    monkeypatch.setattr(producer_module, "from_error_message", slow)
    unacked.looks = [lambda: None, looked]  # the flush first looks whether there is room
    with pytest.raises(st.InvalidArgument, match="not this one"):
        producer.flush(LIMIT_S)
    assert producer.rejections == 1


def test_a_run_whose_sending_a_signal_has_ended_is_sent_again() -> None:
    """In an earlier version, after Ctrl-C in a put, the next flush waited for an ack of a run that was not sent."""
    session = OneChannelSession()
    producer = producer_of(session)
    session.errors.append(KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        producer.put(b"x")
    producer.flush(LIMIT_S)
    assert (session.streams, producer.accepted) == (2, 1)


def test_an_item_keeps_the_attributes_that_its_put_had() -> None:
    """In an earlier version, a program that changed its mapping after a put changed the items that still waited."""
    session = OneChannelSession()
    producer = producer_of(session)
    labels = {"n": "1"}
    for number in range(3):
        labels["n"] = str(number)
        producer.put(b"x", attributes=labels)
    waiting = producer._builder
    assert b"".join(waiting.cut().encoded).count(b"x") == 1
    waiting.drop(waiting.cut())
    assert len(waiting) == 1


class MismatchedMapping(dict[str, Any]):
    """A mapping whose method `items` gives texts instead of the values."""

    def items(self) -> Any:
        return [(key, "text") for key in self.keys()]


@pytest.mark.parametrize("attributes", [MismatchedMapping(n=1), {"n": "x" * 2**14}])
def test_unusable_attributes_are_refused_and_hinder_no_later_put(attributes: Any) -> None:
    """In an earlier version, the host or the encoder refused such an item each time, and all later puts failed."""
    session = OneChannelSession()
    producer = producer_of(session)
    producer.put(b"first")
    for _ in range(2):
        with pytest.raises(st.InvalidArgument):
            producer.put(b"x", attributes=attributes)
    producer.put(b"second")
    assert producer._builder.cut().encoded
    assert len(producer._builder) == 1


def test_a_put_that_interrupts_the_host_of_its_process_never_waits_for_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, `__del__` on the thread of the host waited for acks that this thread had to bring."""
    session = OneChannelSession()
    producer = producer_of(session)
    monkeypatch.setattr(producer._changed, "wait", pytest.fail)
    session.here = SimpleNamespace(is_interrupted=True, target="elsewhere")
    with suppress(st.DeadlineExceeded):
        for _ in range(2000):
            producer.put(bytes(100_000), timeout=None)
    with pytest.raises(st.DeadlineExceeded):
        producer.flush(None)
    assert producer._unacked.length_bytes >= IN_FLIGHT_BYTES_MAX


def test_a_time_beyond_64_bits_is_refused_and_hinders_no_later_put() -> None:
    """In an earlier version, the item stayed in the run under construction, and all later puts failed."""
    session = OneChannelSession()
    producer = producer_of(session)
    for _ in range(2):
        with pytest.raises(st.InvalidArgument):
            producer.put(b"x", time=2**70)
    producer.put(b"x")
    assert len(producer._unacked) == 1
