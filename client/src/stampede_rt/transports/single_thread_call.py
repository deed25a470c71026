"""A gRPC call whose reading thread takes the call's events from gRPC itself (decision 0155).

gRPC's public calls with a stream of requests use a thread for the requests and another one for the events. Each request
and each response then passes between three threads. grpcio uses calls on one thread for calls with one request, but has
no public interface for them. So this module uses private names of grpcio. If a version of grpcio lacks them, `begin`
returns None, and the caller uses the public interface.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Sequence
from typing import Any

import grpc

from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.wire.request_pieces import messages_of

STREAMS_VARIABLE = "STAMPEDE_GRPC_STREAMS"
"""With the value `public` in this environment variable the client uses only the public interface of grpcio."""
_PROPAGATE_DEFAULTS = 0xFFFF
_NO_FLAGS = 0
_CODES = {code.value[0]: code for code in grpc.StatusCode}
_STARTING, _STATUS, _SENT, _RECEIVED = range(4)  # the tags of operations
_log = logging.getLogger("stampede_rt")


class CallEnded(grpc.RpcError):
    """The status of a call that has ended with an error."""

    def __init__(self, code: grpc.StatusCode, details: str, trailers: Sequence[Any]) -> None:
        super().__init__(f"{code.name}: {details}")
        self._code, self._details, self._trailers = code, details, trailers

    def code(self) -> grpc.StatusCode:
        """Return the status code."""
        return self._code

    def details(self) -> str:
        """Return the text of the status."""
        return self._details

    def trailing_metadata(self) -> Any:
        """Return the trailing metadata, as pairs."""
        return self._trailers


def begin(channel: Any, method: BidiMethod, metadata: Any) -> SingleThreadCall | None:
    """Begin a call of `method` on a gRPC channel. Returns None if this grpcio cannot do it.

    Raises ValueError if the channel is closed.
    """
    if os.environ.get(STREAMS_VARIABLE) == "public":
        return None
    try:
        from grpc._cython import cygrpc  # type: ignore[attr-defined]  # private

        started = (
            ((cygrpc.SendInitialMetadataOperation(metadata, _NO_FLAGS),), _STARTING),
            ((cygrpc.ReceiveInitialMetadataOperation(_NO_FLAGS),), _STARTING),
            ((cygrpc.ReceiveStatusOnClientOperation(_NO_FLAGS),), _STATUS),
        )
        call = channel._channel.segregated_call(
            _PROPAGATE_DEFAULTS, method.name.encode(), None, None, metadata, None, started, None, None
        )
    except (ImportError, AttributeError, TypeError) as error:
        _log.debug("this grpcio has no calls on one thread", exc_info=error)
        return None
    return SingleThreadCall(call, cygrpc, method, len(started))


class SingleThreadCall:
    """A call with the methods of `GrpcCall`, for callers that continue to read.

    One thread at a time reads, and any thread may send and cancel.

    gRPC takes one message at a time. `send` begins to send a message immediately if gRPC is sending no other. Otherwise
    the reading thread sends it, so a caller that sends twice must read in between, or have another thread that reads.

    gRPC frees a call when a thread takes the last event of the call. After that no thread may use the call's queue of
    events. So this class counts the events that have not come yet. After an interrupt at an unknown place it takes no
    event any more, and the call stays in memory until its channel closes.
    """

    def __init__(self, call: Any, cygrpc: Any, method: BidiMethod, events: int) -> None:
        self._call = call
        self._encode, self._decode = method.encode or bytes, method.decode or bytes
        self._send_operation, self._receive_operation = cygrpc.SendMessageOperation, cygrpc.ReceiveMessageOperation
        self._mutex = threading.Lock()  # guards the messages and counts below
        self._reading = threading.Lock()  # is held by the thread that takes events
        self._unsent: deque[bytes] = deque()
        self._is_sending = False
        self._events = events  # the events that have not come yet
        self._is_lost = False  # whether an interrupt came at an unknown place
        self._response: Any = None
        self._status: tuple[grpc.StatusCode, str, Sequence[Any]] | None = None

    @property
    def waiting_requests(self) -> int:
        """The number of messages that gRPC has not taken yet."""
        return len(self._unsent)

    def send(self, request: Any) -> None:
        """Send `request` without waiting. If the call has ended, `__next__` raises the reason."""
        messages = [
            message if isinstance(message, bytes) else self._encode(message) for message in messages_of(request)
        ]
        try:
            with self._mutex:
                self._unsent.extend(messages)
                self._send_next()
        except BaseException:
            self._is_lost = True
            raise

    def _send_next(self) -> None:
        """Begin to send the next message. The caller holds the mutex."""
        if self._unsent and not self._is_sending:
            self._is_sending = self._begin((self._send_operation(self._unsent.popleft(), _NO_FLAGS),), _SENT)

    def _begin(self, operations: tuple[Any, ...], tag: int) -> bool:
        """Begin operations. Returns False if the call has ended. The caller holds the mutex."""
        if self._is_lost or not self._events or not self._call.operate(operations, tag):
            return False
        self._events += 1
        return True

    def __iter__(self) -> SingleThreadCall:
        return self

    def __next__(self) -> Any:
        """Return the next response. Raises grpc.RpcError, or StopIteration at the end."""
        with self._reading:
            try:
                with self._mutex:
                    is_open = self._status is None and self._begin((self._receive_operation(_NO_FLAGS),), _RECEIVED)
                while is_open and self._take_event() != _RECEIVED:
                    pass
            except BaseException:
                self._is_lost = True
                raise
            encoded, self._response = self._response, None
            if encoded is None:
                self._take_rest()
                raise self._end()
        try:
            return self._decode(encoded)
        except Exception as error:  # the server has sent bytes that are not the method's responses
            self.cancel()
            raise CallEnded(grpc.StatusCode.INTERNAL, "Exception deserializing response!", ()) from error

    def _take_event(self) -> Any:
        """Wait for the next event of the call, and return its tag."""
        event = self._call.next_event()
        with self._mutex:
            self._events -= 1
            if event.tag == _RECEIVED:
                self._response = event.batch_operations[0].message()
            elif event.tag == _SENT:
                self._is_sending = False
                self._send_next()
            elif event.tag == _STATUS:
                (status,) = event.batch_operations
                code = _CODES.get(status.code(), grpc.StatusCode.UNKNOWN)
                self._status = code, _text(status.details()), status.trailing_metadata() or ()
        return event.tag

    def _take_rest(self) -> None:
        """Take the last events of a call that has ended, so that gRPC frees the call. The caller holds `_reading`."""
        try:
            while self._events and not self._is_lost:
                self._take_event()
        except BaseException:
            self._is_lost = True
            raise

    def _end(self) -> Exception:
        if self._status is None:
            return CallEnded(grpc.StatusCode.CANCELLED, "an interrupt ended the call", ())
        return StopIteration() if self._status[0] is grpc.StatusCode.OK else CallEnded(*self._status)

    def cancel(self) -> None:
        """End the call. Any thread may do this. If no thread reads, this takes the last events of the call."""
        self._call.cancel(grpc.StatusCode.CANCELLED.value[0], "Locally cancelled by application!")
        if self._reading.acquire(blocking=False):
            try:
                self._take_rest()
            finally:
                self._reading.release()


def _text(details: str | bytes | None) -> str:
    return details.decode(errors="replace") if isinstance(details, bytes) else details or ""
