"""The puts of one producer in the host's own process. Its runs come as they are, and not over the wire."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from stampede_rt.cluster.embedding import NO_ATTRIBUTES, RunToPut
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.plain_runs import PlainRun, read_plain_run
from stampede_rt.wire.runs import RunColumns
from stampede_rt_channel_host.channels.calls_here import find_here
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.puts import ChannelPuts
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import ReferencedBody

STEP_SECONDS_MAX = 0.001  # the longest step of the event loop with the runs of one producer
STEP_BYTES_MAX = 2**20  # the runs of one step, because the ring copies all of them at its end

Tell = Callable[[Any], None]


def takes_runs(store: ChannelStore, channel_id: bytes, epoch: int) -> bool:
    """Whether `PutsHere` can put into the channel: no put may have to wait. Raises the errors of `find`."""
    hosted = find_here(store, channel_id, epoch)
    return hosted is not None and not hosted.puts.may_wait


def _puts_of(store: ChannelStore, channel_id: bytes, epoch: int) -> ChannelPuts:
    """The puts of a channel in which no put waits. Raises Unavailable, and the errors of `find`."""
    hosted = find_here(store, channel_id, epoch)
    if hosted is None or hosted.puts.may_wait:
        raise Unavailable("the channel takes puts only over a stream now; the client opens one")
    return hosted.puts


class PutsHere:
    """A stream of runs. Any thread may call `send` and `cancel`, which do not wait. The host's thread puts the runs.

    A payload that is a run of its own stays the object that was put.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        store: ChannelStore,
        channel: tuple[bytes, int],
        producer_id: int,
        on_acks: Tell,
        on_end: Tell,
    ) -> None:
        """`channel`: its id and epoch. `on_acks` gets each PutResponse, and `on_end` the error that ends the stream."""
        self._loop, self._store, self._channel, self._producer_id = loop, store, channel, producer_id
        self._on_acks, self._on_end = on_acks, on_end
        self._sent: deque[RunToPut] = deque()  # the producer bounds the unacknowledged bytes
        self._is_called = False  # whether the loop is to look at the sent runs
        self._refusal: StampedeError | None = None  # the refusal of a run that the producer sends again
        self.is_over = False
        self.on_over: Callable[[], None] | None = None
        """Called once, when the stream has ended."""

    def send(self, runs: Sequence[RunToPut]) -> None:
        """Leave the runs to the host's thread. Raises Unavailable if the host has ended."""
        self._sent.extend(runs)
        if not self._is_called:
            self._is_called = True
            try:
                self._loop.call_soon_threadsafe(self._put_sent)
            except RuntimeError as error:  # the loop has closed
                raise Unavailable("the host of this process has ended") from error

    def cancel(self) -> None:
        """End the stream. Sent runs without an ack may be lost."""
        self.is_over = True
        self._sent.clear()
        on_over, self.on_over = self.on_over, None
        if on_over is not None:
            on_over()

    def end(self, error: StampedeError) -> None:
        """End the stream with an error. The host's thread calls this."""
        if not self.is_over:
            self.cancel()
            self._on_end(error)

    def _put_sent(self) -> None:
        """Put the runs that have come, up to the bounds of a step, and report their acks together."""
        try:
            acks = self._put_all()
        except Exception as defect:  # noqa: BLE001  # the producer must get the error
            self.end(StampedeError(f"a defect in the host of this process: {defect!r}"))
            return
        self._is_called = False
        if self._sent:  # `send` may have seen that the loop was called
            self._is_called = True
            self._loop.call_soon(self._put_sent)
        if acks and not self.is_over:
            self._on_acks(pb.PutResponse(acks=acks))

    def _put_all(self) -> list[pb.PutAck]:
        until_s, left_bytes, acks = time.monotonic() + STEP_SECONDS_MAX, STEP_BYTES_MAX, list[pb.PutAck]()
        try:
            puts = _puts_of(self._store, *self._channel)
        except StampedeError as error:
            return [self._refused(run, error) for run in self._taken()]
        with puts.announced_together():
            while self._sent and not self.is_over and (not acks or (left_bytes > 0 and time.monotonic() < until_s)):
                run = self._sent.popleft()
                left_bytes -= sum(map(len, run.encoded))
                acks.append(self._put(puts, run))
        return acks

    def _taken(self) -> Iterator[RunToPut]:
        while self._sent:
            yield self._sent.popleft()

    def _put(self, puts: ChannelPuts, run: RunToPut) -> pb.PutAck:
        if self._refusal is not None:
            return self._refused(run, self._refusal)
        try:
            ack = puts.put(self._incoming(run), self._store.now())
        except StampedeError as error:
            return self._refused(run, error)
        assert ack is not None, "the channel lets no put wait"
        return ack

    def _refused(self, run: RunToPut, error: StampedeError) -> pb.PutAck:
        """The ack of a refused run. If the producer sends the run again, the stream accepts no later run before it."""
        if error.retryable:
            self._refusal = error
        return refused(run.first_number, run.items, error, self._store.now())

    def _incoming(self, run: RunToPut) -> IncomingRun:
        head, *payloads = run.encoded
        plain = read_plain_run(head, len(head) + len(payloads[0])) if len(payloads) == 1 else None
        body, columns = _joined(run.encoded) if plain is None else _referenced(run.encoded, plain)
        return IncomingRun(
            body, columns=columns, producer_id=self._producer_id, first_number=run.first_number, wait_nanos=0
        )


def _joined(encoded: Sequence[bytes]) -> tuple[bytes, None]:
    return b"".join(encoded), None


def _referenced(encoded: Sequence[bytes], plain: PlainRun) -> tuple[ReferencedBody, RunColumns]:
    times = None if plain.time is None else (plain.time,)
    durations = None if plain.duration is None else (plain.duration,)
    return ReferencedBody(encoded, encoded[-1], NO_ATTRIBUTES, ""), RunColumns(times, durations, (plain.length,))
