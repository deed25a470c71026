"""Streams of responses in the blocking client, with the names of `streams_async`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from itertools import chain
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

import grpc
import grpc.experimental

from stampede_rt.errors import Unavailable
from stampede_rt.status import raise_from_rpc_error
from stampede_rt.transports import forking
from stampede_rt.transports.concurrency_sync import run_later, when_dropped, within_limit
from stampede_rt.transports.grpc_options import SILENCE_S_MAX, WAITING_REQUESTS_MAX
from stampede_rt.transports.socket_sync import SocketCall
from stampede_rt.transports.watchdog import Watchdog
from stampede_rt.wire.request_pieces import messages_of

Response = TypeVar("Response")


def closed(target: str) -> Unavailable:
    """The error of a call during which its connection closed."""
    return Unavailable(f"the connection to {target} is closed")


def silent(target: str) -> Unavailable:
    """The error of a stream on which the server gave no sign of life."""
    return Unavailable(f"{target} gave no sign of life for {SILENCE_S_MAX:g} s; it may be stopped")


def limit_of(call: Any, watchdog: Watchdog) -> Callable[[float | None], AbstractContextManager[list[bool]]]:
    """The function that limits reads of `call`, see `Watchdog.limit`. Streams over sockets need no other thread."""
    return call.limit if isinstance(call, SocketCall) else partial(watchdog.limit, on_overdue=call.cancel)


class GrpcCall:
    """A gRPC call with a stream of requests and a stream of responses.

    Requests wait in a queue until gRPC's sending thread takes them.
    """

    def __init__(self, begin: Callable[[Iterator[Any]], Any]) -> None:
        """`begin` begins the call with the given messages."""
        requests: SimpleQueue[Any] = SimpleQueue()
        self._requests = requests
        self._call = begin(chain.from_iterable(map(messages_of, iter(requests.get, None))))
        # The sending thread waits for requests without a limit. None ends it.
        if not self._call.add_callback(partial(requests.put, None)):
            requests.put(None)  # the call has already ended

    @property
    def waiting_requests(self) -> int:
        """The number of requests that the sending thread has not taken yet."""
        return self._requests.qsize()

    def send(self, request: Any) -> None:
        """Send `request` without waiting. If the call has ended, `__next__` raises the reason."""
        self._requests.put(request)

    def __iter__(self) -> GrpcCall:
        return self

    def __next__(self) -> Any:
        """Return the next response. Raises grpc.RpcError, or StopIteration at the end."""
        return next(self._call)

    def cancel(self) -> None:
        """End the call. Any thread may do this."""
        self._requests.put(None)
        self._call.cancel()


class ServerStream(Generic[Response]):
    """The responses to one request. Any thread may call `cancel`, which ends the iteration."""

    def __init__(self, call: Any, target: str, watchdog: Watchdog) -> None:
        self._call = call
        self._target = target
        self._limit = limit_of(call, watchdog)
        self._forks = forking.forks()
        self._cancelled = False
        when_dropped(self, call.cancel)

    @property
    def target(self) -> str:
        """The address of the server."""
        return self._target

    def __iter__(self) -> Iterator[Response]:
        overdue: list[bool] = []
        try:
            while True:
                with self._limit(SILENCE_S_MAX) as overdue:
                    response = next(self._call)
                yield response
                del response  # it may be a view of the memory into which the next one is read
        except StopIteration:
            pass
        except grpc.RpcError as error:
            if overdue:
                raise silent(self._target) from None
            if not self._cancelled:
                raise_from_rpc_error(error, self._target)
        except GeneratorExit:  # the reader has left. Python may delete the iterator on any thread, while locks are held
            self._cancelled = True
            if self._forks == forking.forks():
                run_later(self._call.cancel)
            raise
        except BaseException:  # an interrupt ends this call. If the reader continues, it opens a new stream
            self._end_call()
            raise
        if not self._cancelled:
            raise Unavailable(f"{self._target} ended the stream")

    def cancel(self) -> None:
        """End the stream."""
        self._cancelled = True
        self._end_call()

    def _end_call(self) -> None:
        if self._forks == forking.forks():  # in a forked child the call is the parent's, and may be locked
            within_limit(self._call.cancel)


class BidiStream(ServerStream[Response]):
    """A stream in both directions: `send` sends requests, and the iteration receives responses."""

    def send(self, request: Any) -> None:
        """Send `request` without waiting. If the stream is broken, the iteration raises the reason.

        Raises Unavailable if WAITING_REQUESTS_MAX requests wait because the server takes none of them.
        """
        if self._call.waiting_requests >= WAITING_REQUESTS_MAX:
            self._call.cancel()
            raise Unavailable(f"{self._target} takes no requests; it may be stopped")
        self._call.send(request)
