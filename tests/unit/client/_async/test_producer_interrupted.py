"""The blocking producer, while a signal handler interrupts it at each bytecode: the handler raises, or makes a put
of its own.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import Any, cast

import pytest

from stampede_rt._sync import producer as producer_module
from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.producer import Producer
from stampede_rt._sync.session import Session
from stampede_rt.cluster.binding import Binding, BindingCache
from stampede_rt.transports import concurrency_sync
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.wire import batching

WATCHED = {module.__file__ for module in (producer_module, concurrency_sync, batching)}
LIMIT_S = 1.0


class Interrupted(BaseException):
    """Raised as Python's own handler of Ctrl-C raises KeyboardInterrupt."""


class Host:
    """A session with one channel, and the host's side of its streams, which acknowledges puts unless `holds_acks`."""

    closed = inherited = False
    here = None

    def __init__(self) -> None:
        self.cache, self.endpoints = BindingCache(), self
        self.payloads: list[bytes] = []
        self.streams: list[Stream] = []
        self.holds_acks = False

    def check_process(self) -> None:
        return

    def to(self, target: str) -> Host:
        return self

    def duplex(self, on_response: Any, on_end: Any) -> Stream:
        self.streams.append(Stream(self, on_response))
        return self.streams[-1]

    def perform(self, state: ChannelState, operation: Any, timeout_s: float = 10.0) -> Any:
        return operation(Binding(subject_id=b"c", target="there", epoch=1, incarnation=1), timeout_s)

    def acknowledge(self) -> None:
        """Send the acks that the host has held, and hold none from now on."""
        self.holds_acks = False
        self.streams[-1].acknowledge()


class Stream:
    """The host's side of one stream."""

    def __init__(self, host: Host, on_response: Any) -> None:
        self.host, self.on_response = host, on_response
        self.held: list[pb.PutAck] = []
        self.ended = False

    def send(self, request: bytes | list[bytes]) -> None:
        for put in pb.PutRequest.FromString(b"".join(request)).puts if isinstance(request, list) else ():
            assert not self.ended
            payloads = _payloads_of(put.run)
            if put.first_number > len(self.host.payloads):  # otherwise the host knows the run from an earlier stream
                assert put.first_number == len(self.host.payloads) + 1, "a run is missing"
                self.host.payloads += payloads
            self.held.append(pb.PutAck(first_number=put.first_number, items=len(payloads)))
        if not self.host.holds_acks:
            self.acknowledge()

    def acknowledge(self) -> None:
        acks, self.held = self.held, []
        if acks:
            self.on_response(pb.PutResponse(acks=acks))

    def cancel(self) -> None:
        self.ended = True


def _payloads_of(run: Any) -> list[bytes]:
    ends, begin = [], 0
    for length in run.payload_length_bytes:
        ends.append(run.payloads[begin : begin + length])
        begin += length
    return ends


def producer_at(host: Host) -> Producer:
    info = ChannelInfo.__new__(ChannelInfo)
    object.__setattr__(info, "channel_id", b"c")
    object.__setattr__(info, "name", "cam/left")
    return Producer(cast(Session, host), ChannelState(info, cast(Policy, None), True))


def interrupt_at(count: int, call: Callable[[], None], handler: Callable[[], None]) -> bool:
    """Call `call`, and `handler` before its bytecode number `count`. Returns whether `call` has this many bytecodes."""
    left = count

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal left
        if frame.f_code.co_filename not in WATCHED:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if not left:
                sys.settrace(None)
                handler()
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return left <= 0


def idle(host: Host, producer: Producer) -> list[bytes]:
    """Nothing is under way, so the put sends its item."""
    producer.put(b"first")
    producer.flush(LIMIT_S)
    return [b"first"]


def gathering(host: Host, producer: Producer) -> list[bytes]:
    """A run is under way, so the put's item waits."""
    host.holds_acks = True
    for payload in (b"first", b"second"):
        producer.put(payload)
    return [b"first", b"second"]


def full(host: Host, producer: Producer) -> list[bytes]:
    """As many items wait as a run may have, so the put sends them first."""
    payloads = [b"first", b"second", bytes(100_000), bytes(100_000)]
    host.holds_acks = True
    for payload in payloads:
        producer.put(payload)
    return payloads


Situation = Callable[[Host, Producer], list[bytes]]
SITUATIONS = (idle, gathering, full)


def interrupted_put(situation: Situation, producer: Producer) -> Callable[[], None]:
    return partial(producer.put, bytes(50_000) if situation is full else b"interrupted")


@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_put_that_raises_at_any_bytecode_loses_and_repeats_no_other_item(
    situation: Situation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, an error lost a run that was complete, but not yet noted as unacknowledged."""

    def raise_interrupted() -> None:
        raise Interrupted

    monkeypatch.setattr(producer_module, "sleep", lambda _: None)  # before a new stream
    for count in range(1, 5000):
        host = Host()
        producer = producer_at(host)
        expected = situation(host, producer)
        try:
            if not interrupt_at(count, interrupted_put(situation, producer), raise_interrupted):
                break
        except Interrupted:
            pass
        host.holds_acks = False
        producer.put(b"last")
        host.acknowledge()
        producer.flush(LIMIT_S)
        without = [one for one in host.payloads if one not in (b"interrupted", bytes(50_000))]
        assert without == [*expected, b"last"], count
        assert len(host.payloads) - len(without) <= 1, count
        assert (len(producer._unacked), len(producer._builder)) == (0, 0), count
        assert producer.accepted == len(host.payloads), count
    assert 30 < count < 4999


@pytest.mark.parametrize("situation", SITUATIONS)
def test_a_signal_handler_puts_at_any_bytecode_of_a_put(situation: Situation) -> None:
    for count in range(1, 5000):
        host = Host()
        producer = producer_at(host)
        expected = situation(host, producer)
        handler = partial(producer.put, b"of the handler")
        if not interrupt_at(count, interrupted_put(situation, producer), handler):
            break
        host.acknowledge()
        producer.flush(LIMIT_S)
        interrupted = bytes(50_000) if situation is full else b"interrupted"
        assert host.payloads[: len(expected)] == expected, count
        assert sorted(host.payloads[len(expected) :]) == sorted([b"of the handler", interrupted]), count
        assert producer.accepted == len(host.payloads), count
    assert 30 < count < 4999
