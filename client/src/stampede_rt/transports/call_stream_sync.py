"""An open bidirectional stream on threads, with the names of `call_stream_async`.

The calling thread itself sends a request and reads its responses, or a thread of the stream reads them. So this module
needs no task that sends, and no futures: it has no counterparts of `Requests`, `within` and `fail`.
"""

from __future__ import annotations

from typing import Any, Protocol
from weakref import ref

import grpc

from stampede_rt.errors import DeadlineExceeded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.transports import forking
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.concurrency_sync import when_dropped, within_limit
from stampede_rt.transports.socket_routes import SocketRoute
from stampede_rt.transports.streams_sync import limit_of
from stampede_rt.transports.watchdog import Watchdog


class StreamEndpoint(Protocol):
    """The part of an endpoint that its streams use."""

    target: str
    route: SocketRoute
    is_stuck: bool

    def begin_bidi(self, method: BidiMethod, *, in_turn: bool, keeps_reading: bool) -> Any:
        """Begin the call of a stream in both directions. Raises Unavailable when the endpoint is closed."""

    def opened(self, stream: CallStream) -> None:
        """Keep a weak reference to the stream, and end the stream when the endpoint closes."""


class CallStream:
    """An open bidirectional stream. It belongs to the thread that opened it."""

    def __init__(self, endpoint: StreamEndpoint, method: BidiMethod, *, in_turn: bool) -> None:
        self._endpoint = ref(endpoint)
        self._target = endpoint.target
        self._call = endpoint.begin_bidi(method, in_turn=in_turn, keeps_reading=True)
        self.broken = False
        self._route, self._late_arrivals = endpoint.route, endpoint.route.late_arrivals
        self._forks = forking.forks()
        endpoint.opened(self)
        # Only the thread that opened this stream may use it. When that thread ends, Python drops this object, and the
        # client closes the stream.
        when_dropped(self, self._call.cancel)

    @property
    def is_outdated(self) -> bool:
        """Whether a new stream may be faster than this one. Then the owner should replace this one while it is idle."""
        return self._route.late_arrivals != self._late_arrivals

    def _error(self, error: BaseException, *, is_overdue: bool = False) -> StampedeError:
        self.cancel()
        if is_overdue:
            return DeadlineExceeded(f"{self._target} did not answer in time; it may be overloaded or stopped")
        if isinstance(error, grpc.RpcError):
            return from_rpc_error(error, self._target)
        return Unavailable(f"{self._target} ended the stream")

    def cancel(self) -> None:
        """End the stream, within END_LIMIT_S. If it does not end, the next call opens a new connection."""
        self.broken = True
        if not within_limit(self.end) and (endpoint := self._endpoint()) is not None:
            endpoint.is_stuck = True

    def end(self) -> None:
        """End the stream. Call this on a thread that may wait for gRPC's locks."""
        self.broken = True
        if self._forks == forking.forks():
            self._call.cancel()


class LockstepStream(CallStream):
    """A stream with at most one request under way."""

    def __init__(self, endpoint: StreamEndpoint, method: BidiMethod, watchdog: Watchdog) -> None:
        super().__init__(endpoint, method, in_turn=True)
        self._limit = limit_of(self._call, watchdog)
        self._next_id = 0

    def _next(self, limit: list[bool]) -> Any:
        try:
            return next(self._call)
        except (grpc.RpcError, StopIteration) as error:
            # Raise without a local variable: it would keep the error alive together with this frame.
            raise self._error(error, is_overdue=bool(limit)) from error
        except BaseException:  # an interrupt: otherwise the next request would get the answer of this one
            self.cancel()
            raise
