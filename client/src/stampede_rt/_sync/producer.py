# Generated from ../_async by tools/generate.py; do not edit.
"""Puts many items without waiting for each ack. While acks are on their way, collects the next items in runs."""

from __future__ import annotations

import random
import time as clock
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import TracebackType
from typing import Any

from stampede_rt._sync.calls_here import end_of_call_s
from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.run_streams import RunStream, open_run_stream, weakly
from stampede_rt._sync.session import CALL_TIMEOUT_S, Session, request_id
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import DeadlineExceeded, InvalidArgument, StampedeError, Unavailable
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.crediting import ITEM_OVERHEAD_BYTES
from stampede_rt.pacing.retry import Backoff
from stampede_rt.status import from_error_message
from stampede_rt.transports.concurrency_sync import Signal, Steps, sleep, when_dropped
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.model import Ack
from stampede_rt.values.payloads import check_payload, copied_attributes
from stampede_rt.values.policy import ack_of, content_type_of
from stampede_rt.values.timeline import DurationLike, InstantLike, parse_instant, parse_item_duration
from stampede_rt.wire.batching import NumberedRun, RunBuilder, UnackedRuns
from stampede_rt.wire.records import ack_to_wire

IN_FLIGHT_BYTES_MAX = 8 * 1024 * 1024  # the most bytes of unacknowledged runs
IN_FLIGHT_RUNS_MAX = 64
REJECTIONS_KEPT_MAX = 1024  # errors in `rejected`
_in_flight: set[Producer] = set()  # keeps producers alive until the host has acknowledged their items


class Producer(BoundToProcess):
    """Puts items without waiting for their acks (see `Channel.producer`). The unacknowledged bytes have a bound.

    Use the producer as a context manager, from one thread or task. At the end of the block the producer flushes, unless
    the block raised an error. `rejected` lists the errors of the refused items since the last flush, at most 1024. A
    program may drop a producer without closing it. The producer's stream then ends after the last ack.
    """

    def __init__(self, session: Session, state: ChannelState, ack: Ack | None = None) -> None:
        session.check_process()
        self._session = session
        self._state = state
        self._producer_id = int.from_bytes(request_id()[:8], "little") | 1
        self._ack = ack_to_wire(ack_of(ack))
        self._builder = RunBuilder()
        self._unacked = UnackedRuns()
        self._steps = Steps()  # guards the builder and the order of writes; the threads that bring acks do not wait
        # The acks and the ends of streams that no step has noted yet, each with the generation of its stream.
        self._outcomes: deque[tuple[int, channel_pb.PutAck | StampedeError]] = deque()
        self._interrupting_bytes = 0  # the bytes of items that signal handlers put while they interrupted other puts
        self._changed = Signal()  # is set when an ack has come, or when the stream has ended
        self._stream: RunStream | None = None
        self._opened: list[RunStream] = []  # holds the latest stream, which `_give_up` cancels
        self._generation = 0  # the number of the stream; acks of an older stream do not count
        self._failure: StampedeError | None = None
        self._backoff: Backoff | None = None  # set from a failure until the next ack
        self._finished = False
        self.rejected: list[StampedeError] = []
        when_dropped(self, partial(_give_up, self._opened))

    @property
    def accepted(self) -> int:
        """The number of items that the host has accepted."""
        return self._unacked.answered.accepted

    @property
    def rejections(self) -> int:
        """The number of items that the host has refused."""
        return self._unacked.answered.refused

    def __repr__(self) -> str:
        state = self._session.state or ("closed" if self._finished else "")
        ended = f", {state}" if state else ""
        return f"<Producer of channel {self._state.info.name!r}, {self.accepted} accepted{ended}>"

    def __enter__(self) -> Producer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.flush()
        finally:
            self._finished = True
            self.close()

    def put(
        self,
        payload: Any,
        *,
        time: InstantLike | None = None,
        duration: DurationLike | int | None = None,
        attributes: Mapping[str, str] | None = None,
        content_type: str | None = None,
        timeout: float | None = CALL_TIMEOUT_S,
    ) -> None:
        """Accept one item for sending.

        The producer sends an item immediately if no earlier item is unacknowledged. Otherwise it collects items in
        runs, and sends several runs together. If 256 items or 224 KiB are collected, the call blocks while 8 MiB or 64
        runs are unacknowledged. The call also blocks while the producer opens a stream.

        `timeout` in seconds is the longest wait, by default 10; None waits without a limit, as a channel with
        on_full="block" may need. The other arguments are as in `Channel.put`. If a put raises or is cancelled, the
        producer does not send its item. Raises DeadlineExceeded after the timeout, InvalidArgument, ItemTooLarge,
        CodecError; Unavailable if the host cannot be reached for 10 s. A signal handler may put, too. If the handler
        interrupts a put, and there is no room, its put raises DeadlineExceeded without a wait. The same holds for
        `__del__` on the thread of a host of this process.
        """
        self._session.check_process()
        if self._finished:
            raise InvalidArgument("this producer is closed; make another with channel.producer()")
        coding = self._state.coding
        payload = coding.encode(payload) if coding else check_payload(payload)
        labels = None if attributes is None else copied_attributes(attributes)
        instant = None if time is None else parse_instant(time)
        nanos = duration if duration is None else parse_item_duration(duration)
        item = payload, instant, nanos, labels, content_type_of(content_type) or (coding.content_type if coding else "")
        length_bytes = len(payload)
        if self._stream is None or self._failure is not None or not self._builder.add_within(item, length_bytes):
            self._make_room(length_bytes, timeout)
            self._builder.add(item, length_bytes)
        if self._unacked.is_idle:  # no ack under way will send the item
            self._do(self._send_filled)

    def _make_room(self, length_bytes: int, timeout: float | None) -> None:
        """Block until there is a stream and an item of this length may wait. A signal handler does not block."""
        if self._steps.is_interrupted:
            self._count_interrupting(length_bytes)
            return
        self._interrupting_bytes = 0
        deadline_s = end_of_call_s(self._session, timeout)
        while self._stream is None or self._failure is not None or not self._builder.has_room(length_bytes):
            self._send(deadline_s)

    def flush(self, timeout: float | None = CALL_TIMEOUT_S) -> None:
        """Block until the host has accepted or refused every item. Then raise the first refusal, if there is one.

        `timeout` in seconds is the longest wait, by default 10; None waits without a limit. Raises DeadlineExceeded
        after the timeout, and Unavailable if the host cannot be reached for 10 s.
        """
        self._session.check_process()
        deadline_s = end_of_call_s(self._session, timeout)
        if self._steps.is_interrupted:
            raise _interrupting("flush")
        self._send_all(deadline_s)
        self._until(lambda: not len(self._unacked) and not len(self._builder), deadline_s)
        refused, self.rejected = self.rejected, []
        if refused:
            raise refused[0]

    def close(self) -> None:
        """Close the stream. Items without an ack may be lost; call `flush` first."""
        if not self._session.inherited:
            self._steps.run(self._end_stream)

    def _end_stream(self) -> None:
        self._generation += 1
        stream, self._stream = self._stream, None
        _in_flight.discard(self)
        if stream is not None:
            stream.cancel()

    def _count_interrupting(self, length_bytes: int) -> None:
        """Count an item of a signal handler or `__del__` that interrupts a put. Such a put cannot wait for room."""
        self._interrupting_bytes += length_bytes + ITEM_OVERHEAD_BYTES
        if self._interrupting_bytes + self._unacked.length_bytes > IN_FLIGHT_BYTES_MAX:
            raise _interrupting("wait for room")

    def _has_room(self) -> bool:
        return self._unacked.length_bytes < IN_FLIGHT_BYTES_MAX and len(self._unacked) < IN_FLIGHT_RUNS_MAX

    def _send(self, deadline_s: float = float("inf")) -> None:
        """Finish the run under construction as soon as there is room, and send full messages."""
        if self._stream is None and self._failure is None:  # without a stream no ack makes room
            self._open(max(min(deadline_s - clock.monotonic(), CALL_TIMEOUT_S), 0.0))
        self._until(self._has_room, deadline_s)
        self._do(self._send_filled)

    def _send_all(self, deadline_s: float = float("inf")) -> None:
        """Finish the run under construction as soon as there is room, and send all gathered runs."""
        self._send(deadline_s)
        self._do(lambda: self._write(self._unacked.take_gathered()))

    def _do(self, step: Callable[[], None]) -> None:
        """Run a step. If a signal ends it, a later call sends all unacknowledged runs again over another stream."""
        try:
            self._steps.run(step)
        except BaseException:
            self._failure = self._failure or Unavailable("a signal handler has interrupted a put; put again")
            raise

    def _send_filled(self) -> None:
        """Finish runs as long as there is room, and send full messages. This is a part of a step.

        If no sent run is unacknowledged, this sends everything. A call that a signal has ended may be repeated.
        """
        self._builder.drop(self._unacked.last)  # a signal may have ended a call between `add` and `drop`
        while len(self._builder) and self._has_room():
            _in_flight.add(self)
            self._unacked.add(self._builder.cut())
            self._builder.drop(self._unacked.last)
        self._write(self._unacked.take_ready())

    def _write(self, requests: Sequence[Sequence[NumberedRun]]) -> None:
        """Write messages. If the stream is broken, `_open` sends the runs again over the next stream."""
        try:
            for runs in requests:
                if self._stream is not None:
                    self._stream.send(runs)
        except Unavailable as error:
            self._failure = self._failure or error

    def _until(self, condition: Callable[[], bool], deadline_s: float) -> None:
        """Block until `condition` holds. Replace the stream if it fails meanwhile. Raises DeadlineExceeded."""
        while True:
            self._changed.clear()
            is_ready = self._holds(condition)
            left_s = deadline_s - clock.monotonic()
            if self._failure is not None and left_s > 0:
                self._recover(self._failure, left_s)
            elif is_ready:
                return
            else:
                if left_s <= 0:
                    raise DeadlineExceeded(
                        f"the host of channel {self._state.info.name!r} did not acknowledge {len(self._unacked)} runs "
                        "in time: it is overloaded, or the channel is full; give a longer timeout, or put less"
                    )
                self._changed.wait(None if left_s == float("inf") else left_s)

    def _holds(self, condition: Callable[[], bool]) -> bool:
        """Whether there is no failure and `condition` holds. No other thread counts an ack during this check."""
        found: list[bool] = []

        def look() -> None:
            self._take_news()  # a signal may have interrupted the last call
            found.append(self._failure is None and condition())

        self._do(look)
        return found == [True]

    def _recover(self, failure: StampedeError, left_s: float) -> None:
        """Replace a stream that ended with `failure`.

        Raises `failure` if it is not retryable, or if no ack has come for 10 s since the first failure. The producer
        keeps the unacknowledged items, and the next put or flush tries again to send them.
        """
        self._backoff = self._backoff or Backoff(clock.monotonic() + CALL_TIMEOUT_S)
        delay_s = self._backoff.next_delay_s(clock.monotonic(), random.random())
        if not failure.retryable or delay_s is None:
            self.close()
            self._failure = self._backoff = None
            raise failure
        self._session.cache.forget(self._state.info.channel_id)
        if failure.reason == "MOVED":  # the new host takes the items without a delay
            self._session.cache.follow(self._state.info.channel_id, failure.metadata)
        else:
            sleep(min(delay_s, left_s))
        self._open(min(left_s, CALL_TIMEOUT_S))

    def _open(self, timeout_s: float = CALL_TIMEOUT_S) -> None:
        """Open a stream to the channel's present host, and send unacknowledged runs again with their old numbers."""
        self.close()

        def open_at(binding: Binding, _: float) -> None:  # awaits nothing, so no cancellation can interrupt it
            generation = self._generation
            callbacks = partial(weakly(self._acked), generation), partial(weakly(self._ended), generation)
            stream = open_run_stream(self._session, binding, self._producer_id, self._ack, *callbacks)
            self._do(partial(self._begin, stream, generation))

        self._session.perform(self._state, open_at, timeout_s)

    def _begin(self, stream: RunStream, generation: int) -> None:
        """Begin to use the stream, and send the unacknowledged runs again."""
        if generation != self._generation or self._stream is not None:  # a signal handler used the producer meanwhile
            if stream is not self._stream:
                stream.cancel()
            return
        self._stream, self._failure = stream, None
        self._opened[:] = [stream]
        self._builder.drop(self._unacked.last)
        self._write(self._unacked.resend())
        if len(self._unacked):
            _in_flight.add(self)
        else:
            self._backoff = None  # no run is unacknowledged, so no ack will end the backoff

    def _acked(self, generation: int, response: channel_pb.PutResponse) -> None:
        self._outcomes.extend([(generation, ack) for ack in response.acks])
        self._steps.offer(self._take_news)

    def _ended(self, generation: int, error: StampedeError) -> None:
        self._outcomes.append((generation, error))
        self._steps.offer(self._take_news)

    def _take_news(self) -> None:
        """Note the acks and the end of the stream. If a signal interrupts this, the next call goes on."""
        if not self._outcomes:
            return
        while self._outcomes:
            generation, outcome = self._outcomes[0]
            if generation == self._generation and self._failure is None:
                self._note(outcome)
            self._outcomes.popleft()
        if self._failure is not None or not (len(self._unacked) or len(self._builder)):
            _in_flight.discard(self)
        elif self._unacked.is_idle:
            self._send_filled()
        self._changed.set()

    def _note(self, outcome: channel_pb.PutAck | StampedeError) -> None:
        if isinstance(outcome, StampedeError):
            self._failure = outcome
        elif self._unacked.awaits(outcome.first_number):  # otherwise an interrupted call has counted this ack
            self._count(outcome)

    def _count(self, ack: channel_pb.PutAck) -> None:
        refusal = from_error_message(ack.error) if ack.HasField("error") else None
        if refusal is not None and refusal.retryable:  # the channel may have another host now: send the run again
            self._failure = refusal
            return
        self._backoff = None
        items = self._unacked.first.items
        refusals = [refusal] * items if refusal else [from_error_message(one.error) for one in ack.rejections]
        # Before `acknowledge`: if a signal ends this call between the two lines, the next call counts the ack again.
        self.rejected += refusals[: REJECTIONS_KEPT_MAX - len(self.rejected)]
        self._unacked.acknowledge(len(refusals))


def _interrupting(doing: str) -> DeadlineExceeded:
    return DeadlineExceeded(
        f"this call interrupts another call of the same producer on its thread, so it cannot {doing}; a signal handler "
        "or __del__ should set a flag, and the program should put later"
    )


def _give_up(streams: list[RunStream]) -> None:
    for stream in streams:
        stream.cancel()
