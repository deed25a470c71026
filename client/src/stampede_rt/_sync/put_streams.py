# Generated from ../_async by tools/generate.py; do not edit.
"""The open put streams of a connection, for all its handles."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from typing import Any

from stampede_rt.cluster.binding import Binding
from stampede_rt.transports.concurrency_sync import Mutex, live_thread_ids, thread_id, when_dropped
from stampede_rt.transports.grpc_sync import PutExchange

STREAMS_MAX = 512  # the most streams of puts of one connection
OWNER_STREAMS_MAX = 16  # the most open streams of one owner and thread, for puts with different deadlines
Owner = int | tuple[object, str]
"""The owner of a stream. If a handle has streams of its own, the owner is the id of the handle.

All other handles share one owner: the kind of put, with the host's address.
"""
StreamKey = tuple[Owner, int, int]
"""The owner, the thread, and the number of the stream among the streams of this owner and thread."""
_handle_ids = itertools.count(1)


class PutStream:
    """One open stream to a host.

    `puts` is the number of puts under way on the stream, and `ends_s` the time at which the last of them gives up. Each
    put names its channel or queue, so puts to all channels and queues of the host `target` can use the stream.
    """

    __slots__ = ("ends_s", "exchange", "puts", "target")

    def __init__(self, target: str, exchange: PutExchange) -> None:
        self.target = target
        self.exchange = exchange
        self.puts = 0
        self.ends_s = 0.0

    def leads_to(self, binding: Binding) -> bool:
        """Whether a put to the host of `binding` may use the stream. If not, a new stream replaces it."""
        is_behind = not self.puts and self.exchange.is_outdated
        return self.target == binding.target and not self.exchange.broken and not is_behind

    def is_free(self, ends_s: float) -> bool:
        """Whether all puts under way give up by `ends_s`, so that a new put can end by `ends_s`, too."""
        return not self.puts or (self.ends_s <= ends_s and not self.exchange.one_at_a_time)


class PutStreams:
    """Keeps one open stream for each host and thread. Beyond 512 streams it closes the least recently used idle stream.

    A put that waits for room blocks later puts on its stream. A handle whose puts may wait therefore has streams of its
    own. A put with an earlier deadline uses another of these streams, so that it does not wait beyond its deadline.
    Puts of one handle and thread with equal timeouts stay in order (decision 0150). In the blocking client no handle
    needs streams of its own, because each thread has only one put under way.
    """

    def __init__(self) -> None:
        self._streams: dict[StreamKey, PutStream] = {}  # the least recently used stream is first
        self._mutex = Mutex()

    def handle(self, owner: object) -> int:
        """Return the id of a new handle. The handle's streams close when the program no longer references `owner`."""
        handle_id = next(_handle_ids)
        when_dropped(owner, partial(self._let_go, handle_id))
        return handle_id

    def use(
        self, owner: Owner, ends_s: float, binding: Binding, open_stream: Callable[[], PutExchange]
    ) -> AbstractContextManager[PutExchange]:
        """Return a context with the owner's stream to the host of `binding`, for one put.

        The put may wait for room until `ends_s` (monotonic clock).
        """
        return _PutUnderWay(self, owner, ends_s, binding, open_stream)

    def begin(
        self, owner: Owner, ends_s: float, binding: Binding, open_stream: Callable[[], PutExchange]
    ) -> tuple[StreamKey, PutStream]:
        """Note that a put begins, and return its stream with the key. `end` must follow. The arguments: see `use`."""
        key = self._key_of_free(owner, ends_s)
        stream = self._streams.get(key)
        if stream is None or not stream.leads_to(binding):
            stream = self._replace(key, PutStream(binding.target, open_stream()))
        with self._mutex:
            stream.ends_s = max(stream.ends_s, ends_s) if stream.puts else ends_s
            stream.puts += 1
            if self._streams.pop(key, None) is stream:
                self._streams[key] = stream  # the most recently used stream is the last in the order
        return key, stream

    def end(self, key: StreamKey, stream: PutStream) -> None:
        """Note that a put has ended. If the stream was closed meanwhile, its last put ends it."""
        with self._mutex:
            stream.puts -= 1
            over = not stream.puts and self._streams.get(key) is not stream
        if over:
            stream.exchange.cancel()

    def _key_of_free(self, owner: Owner, ends_s: float) -> StreamKey:
        """Return the key of a stream on which no put waits beyond `ends_s`. The stream may not exist yet.

        If all streams of the owner and thread are busy with longer waits, returns the key of the last one.
        """
        caller = thread_id()
        for number in range(OWNER_STREAMS_MAX - 1):
            stream = self._streams.get((owner, caller, number))
            if stream is None or stream.is_free(ends_s):
                return owner, caller, number
        return owner, caller, OWNER_STREAMS_MAX - 1

    def _replace(self, key: StreamKey, stream: PutStream) -> PutStream:
        with self._mutex:
            gone = [self._streams.pop(key, None)]  # a stream with a stale binding
            alive = live_thread_ids()
            gone += [self._streams.pop(one) for one in tuple(self._streams) if one[1] not in alive]
            idle = [one for one, open_one in self._streams.items() if not open_one.puts]
            gone += [self._streams.pop(one) for one in idle[: max(0, len(self._streams) + 1 - STREAMS_MAX)]]
            self._streams[key] = stream
        _close(gone)
        return stream

    def close(self, handle_id: int) -> None:
        """Close the handle's own streams. A busy stream closes after its puts. A later put opens a new stream."""
        with self._mutex:
            gone = [self._streams.pop(one, None) for one in tuple(self._streams) if one[0] == handle_id]
        _close(gone)

    def _let_go(self, handle_id: int) -> None:
        self.close(handle_id)


class _PutUnderWay:
    """The context of one put."""

    __slots__ = ("_arguments", "_stream_and_put", "_streams")

    def __init__(self, streams: PutStreams, *arguments: Any) -> None:
        """`arguments`: the arguments of `PutStreams.begin`."""
        self._streams, self._arguments = streams, arguments

    def __enter__(self) -> PutExchange:
        self._stream_and_put = self._streams.begin(*self._arguments)
        return self._stream_and_put[1].exchange

    def __exit__(self, *_error: object) -> None:
        self._streams.end(*self._stream_and_put)


def _close(streams: list[PutStream | None]) -> None:
    for stream in streams:
        if stream is not None and not stream.puts:
            stream.exchange.cancel()
