# Generated from ../_async by tools/generate.py; do not edit.
"""Takes messages from a queue over one open stream, for all callers that wait at one handle."""

from __future__ import annotations

import logging
import os
import socket
from collections import deque
from contextlib import suppress
from functools import partial

from stampede_rt._sync.attempts import Locator, attempt
from stampede_rt._sync.endpoints import connection_closed
from stampede_rt._sync.message import Message, Settler
from stampede_rt._sync.prefetch_buffer import PrefetchBuffer
from stampede_rt._sync.queue_locator import QueueState
from stampede_rt._sync.session import CALL_TIMEOUT_S, Session
from stampede_rt._sync.waiting_take import WaitingTake
from stampede_rt.cluster.binding import Binding
from stampede_rt.errors import InvalidArgument, StampedeError, Unavailable
from stampede_rt.pacing.retry import FIRST_DELAY_S
from stampede_rt.transports.concurrency_sync import BackgroundTask, Mutex, Signal, sleep
from stampede_rt.transports.streams_sync import BidiStream
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.values.queueing import PREFETCH_MAX
from stampede_rt.values.reading import Wait
from stampede_rt.wire.delivered import check_granted
from stampede_rt.wire.queues import deliveries_of

# The wait for the end of a drained stream. It is longer than a call: if the worker cannot open a stream, the callers
# still learn the reason from the worker.
DRAIN_TIMEOUT_S = CALL_TIMEOUT_S + 2.0
END_TIMEOUT_S = 1.0  # for each step of the end of a handle
_log = logging.getLogger("stampede_rt")


class Taker:
    """The open Take stream of a handle, and the waiting callers. The taker serves them in the order of their calls.

    The host may send one message for each waiting caller, or `prefetch` messages if that is more. When a caller leaves,
    the host may have credit for a message that nobody waits for. The taker then drains the stream: it takes the credit
    back, and gives back the messages that come meanwhile. The first `get` opens the stream, and the taker opens it
    again after a break. If this process dies, the host delivers its messages to other takers when the leases end.
    """

    def __init__(self, session: Session, locator: Locator, state: QueueState, prefetch: int, name: str = "") -> None:
        self._name = name or _this_process()
        self._session = session
        self._locator = locator
        self._state = state
        self.prefetch = prefetch
        self._taker_id = int.from_bytes(os.urandom(8), "little") | 1
        self._settler = Settler(session, locator, self._taker_id)
        self._mutex = Mutex()  # guards everything below
        self._waiting: deque[WaitingTake] = deque()
        # At most `prefetch` messages.
        self._ready = PrefetchBuffer(self._settler, self._give_back, f"{state.kind} {state.name!r}")
        self._stream: BidiStream[queue_pb.TakeResponse] | None = None
        self._credit = 0  # the number of messages that the host may still send
        self._draining = False  # whether the taker has asked the host to end the stream
        self._opened = Signal()  # is set while the stream is open, and while no stream is wanted
        self._drained = Signal()  # is set when the present stream has ended; each stream has its own signal
        self._incarnation = 0  # the queue's incarnation
        self._worker: BackgroundTask | None = None  # opens streams and receives messages while messages are wanted
        self.closed = False

    def get(self, wait: Wait) -> Message | None:
        """Return the next message; None after the wait, or if the handle is closed meanwhile.

        Raises the error that ended the stream, and InvalidArgument if the handle is closed already.
        """
        self._session.check_process()
        waiter = WaitingTake()
        with self._mutex:
            if self._session.closing or self._session.closed:  # a closing connection first closes its handles
                raise connection_closed()
            if self.closed:
                raise InvalidArgument(f"this handle of {self._state.name!r} is closed; open another")
            waiter.message = self._ready.take()
            if waiter.message is None:
                self._waiting.append(waiter)
        self._wait(waiter, wait)
        if waiter.error is not None:
            raise waiter.error
        return waiter.message

    def _wait(self, waiter: WaitingTake, wait: Wait) -> None:
        """Wait until the caller has a message, or an error, or until its time is over. If interrupted, tidy up."""
        over = False
        try:
            self._ask()
            if waiter.message is None and not waiter.finished.wait(wait.seconds):
                # A caller with timeout 0 still gets a message that the host has.
                waiter.requested.wait(DRAIN_TIMEOUT_S)
                waiter.is_leaving = True
                self._drain(DRAIN_TIMEOUT_S)
            over = True
        finally:
            self._leave(waiter)
            if not over:
                BackgroundTask(partial(self._after_interruption, waiter), f"tidying up {self._state.name}")

    def _leave(self, waiter: WaitingTake) -> None:
        with self._mutex:
            if waiter in self._waiting:
                self._waiting.remove(waiter)

    def _after_interruption(self, waiter: WaitingTake) -> None:
        """Hand the interrupted caller's message to the next caller or give it back, and drain the stream."""
        message = waiter.message
        if message is not None and message.lease_left and not self._pass_on(message, first=True):
            self._give_back([message])
        self._drain(DRAIN_TIMEOUT_S)

    def _wanted(self) -> int:
        waiting = sum(not waiter.is_leaving for waiter in self._waiting)
        ahead = self.prefetch if self.prefetch > 1 and not self.closed else 0
        return min(max(waiting, ahead - len(self._ready)), PREFETCH_MAX)

    def _ask(self) -> None:
        """Give the host credit for as many messages as are wanted and not yet covered by its credit."""
        with self._mutex:
            if self._worker is None and self._wanted():
                self._session.attach(self)
                self._opened.clear()
                self._worker = BackgroundTask(self._work, f"taking from {self._state.name}")
            more = self._wanted() - self._credit
            stream, asking = self._stream, tuple(self._waiting)
            if stream is None or self._draining:  # the next stream asks for the messages that are wanted then
                return
            if not asking and more * 2 < self.prefetch:  # ask for prefetched messages in batches
                return
            self._credit += max(more, 0)
        if more > 0:
            with suppress(Unavailable):  # the worker replaces a broken stream
                stream.send(queue_pb.TakeRequest(credit=more))
        for waiter in asking:
            waiter.requested.set()

    def _drain(self, timeout_s: float) -> None:
        """End the stream if the host has credit for unwanted messages, and wait for its end.

        The waiting callers, also callers that are leaving, get the messages that come meanwhile.
        """
        if self._worker is None:
            return
        self._opened.wait(timeout_s)
        with self._mutex:
            stream, drained = self._stream, self._drained
            if stream is None or self._credit <= self._wanted():
                return
            begin, self._draining = not self._draining, True
        if begin:
            with suppress(Unavailable):
                stream.send(queue_pb.TakeRequest(drain=True))
        if not drained.wait(timeout_s):
            stream.cancel()  # the host hangs

    def _work(self) -> None:
        """Keep a stream open as long as messages are wanted."""
        try:
            while self._is_still_wanted():
                attempt(self._locator, self._take_at, CALL_TIMEOUT_S)
        except StampedeError as error:
            self._fail(error)
        except Exception as error:
            self._fail(StampedeError(f"{self._state.kind} {self._state.name!r} failed with a defect: {error!r}"))
            raise

    def _is_still_wanted(self) -> bool:
        with self._mutex:
            wanted = not self._session.closed and self._wanted() > 0
            if not wanted:
                self._note_worker_end()
        return wanted

    def _note_worker_end(self) -> None:
        """Note that no worker runs. Wake callers that wait for the opening of a stream. Call this with the mutex."""
        self._worker = None
        self._opened.set()
        if not len(self._ready):
            self._session.detach(self)

    def _fail(self, error: StampedeError) -> None:
        with self._mutex:
            self._note_worker_end()
            waiting = tuple(self._waiting)
            self._waiting.clear()
        for waiter in waiting:
            waiter.finish(error=error)

    def interrupt(self, error: StampedeError) -> None:
        """End the stream, because the peer is no longer registered. Waiting callers raise `error`.

        Later callers raise the error of the locator.
        """
        with self._mutex:
            stream, self._stream = self._stream, None
        self._fail(error)
        if stream is not None:
            stream.cancel()

    def _take_at(self, binding: Binding, _: float) -> None:
        """Take messages over one stream until the stream ends, if messages are still wanted.

        Raises the error of the stream, except a retryable error after the first response. After such an error this
        method returns, so that the worker opens the next stream.
        """
        with self._mutex:
            self._credit = self._wanted()
            if not self._credit:  # all callers left before the stream was open
                return
        endpoint = self._session.endpoints.to(binding.target)
        stream: BidiStream[queue_pb.TakeResponse] = endpoint.open_bidi(endpoint.queues.Take)
        has_response = False
        opening = queue_pb.TakeOpen(
            queue_id=binding.subject_id,
            epoch=binding.epoch,
            taker_id=self._taker_id,
            taker_name=self._name,
        )
        try:
            stream.send(queue_pb.TakeRequest(open=opening, credit=self._credit))
            for response in stream:  # the first response says that the stream is open
                if not has_response:
                    has_response = True
                    self._begin(stream)
                self._receive(stream, response)
        except StampedeError as error:
            if not (error.retryable and has_response):
                raise
            self._locator.forget()
            sleep(FIRST_DELAY_S)
        finally:
            self._ended()

    def _begin(self, stream: BidiStream[queue_pb.TakeResponse]) -> None:
        with self._mutex:
            self._stream = stream
            self._opened.set()
            unwanted = not self._wanted() and not self._draining
            self._draining = self._draining or unwanted
        if not unwanted:
            self._ask()
            return
        # Here and not in `_drain`, because `_drain` may have stopped waiting for the stream.
        with suppress(Unavailable):
            stream.send(queue_pb.TakeRequest(drain=True))

    def _ended(self) -> None:
        with self._mutex:
            self._stream = None
            self._credit = 0
            self._draining = False
            self._opened.clear()
            self._drained.set()
            self._drained = Signal()

    def _receive(self, stream: BidiStream[queue_pb.TakeResponse], response: queue_pb.TakeResponse) -> None:
        self._incarnation = response.incarnation or self._incarnation
        content_type = self._state.info.policy.content_type or ""
        unwanted: list[Message] = []
        check_granted(sum(len(run.delivery_ids) for run in response.runs), self._credit)
        for run in response.runs:
            for delivery in deliveries_of(run, content_type):
                message = Message(self._settler, delivery, self._incarnation, self._state.coding)
                if not self._hand_over(message):
                    unwanted.append(message)
        if not response.ByteSize():  # the host's sign of life, which the client answers
            with suppress(Unavailable):
                stream.send(queue_pb.TakeRequest())
        if response.drained:
            stream.cancel()  # the credit of this stream is void; the next stream serves the waiting callers
        if unwanted:
            self._give_back(unwanted)
        if not response.drained and len(self._waiting) > self._credit:
            self._ask()  # more callers wait than one request can ask for

    def _hand_over(self, message: Message) -> bool:
        with self._mutex:
            self._credit -= 1
        return self._pass_on(message)

    def _pass_on(self, message: Message, *, first: bool = False) -> bool:
        """Give the message to the caller that has waited longest. If no caller waits, prefetch it for the next caller.

        Returns False if no caller waits and the handle does not prefetch.
        """
        with self._mutex:
            waiter = self._waiting.popleft() if self._waiting else None
            if waiter is None and self.prefetch > 1 and not self.closed:
                self._ready.add(message, first=first)
                return True
        if waiter is None:
            return False
        waiter.finish(message)
        return True

    def _give_back(self, messages: list[Message]) -> None:
        try:
            self._settler.give_back(messages, END_TIMEOUT_S)
        except StampedeError as error:
            _log.warning(
                "%d messages of %s %r could not be given back; they come again when their leases end: %s",
                len(messages), self._state.kind, self._state.name, error,
            )  # fmt: skip

    def let_go(self) -> None:
        """End without blocking. Python calls this when the program no longer references the handle."""
        self.closed = True
        if self._session.inherited:
            return
        if self._worker is not None or len(self._ready):
            BackgroundTask(self.end, f"closing {self._state.name}")

    def end(self) -> None:
        """Wake the waiting callers, drain the stream, and give back the messages that no caller received."""
        if self._session.inherited:
            return
        with self._mutex:
            self.closed = True
            waiting, worker = tuple(self._waiting), self._worker
            self._waiting.clear()
        for waiter in waiting:
            waiter.finish(error=connection_closed() if self._session.closing else None)
        self._drain(END_TIMEOUT_S)
        with self._mutex:
            stream, unwanted = self._stream, self._ready.take_all()
        if stream is not None:
            stream.cancel()
        if unwanted:
            self._give_back(unwanted)
        if worker is not None:
            worker.join(END_TIMEOUT_S)
        self._session.detach(self)


def _this_process() -> str:
    """Return the machine and process, as the name of a taker whose connection has no name. It is for people."""
    return f"{socket.gethostname()[:100]}:{os.getpid()}"
