"""The puts of one producer in the host's own process. Its runs come as they are, and not over the wire."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Sequence
from contextlib import nullcontext, suppress
from typing import Any, NamedTuple

from stampede_rt.cluster.embedding import NO_ATTRIBUTES, RunToPut
from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.plain_runs import PlainRun, read_plain_run
from stampede_rt.wire.runs import RunColumns
from stampede_rt_channel_host.channels.calls_here import find_here, put_now
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.puts.held_acks import HELD_ACKS_MAX, HeldAck, HeldAcks
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.wanted_acks import check_wanted, held_ack
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.core.channel import ReferencedBody

STEP_SECONDS_MAX = 0.001  # the longest step of the event loop with the runs of one producer
STEP_BYTES_MAX = 2**20  # the runs of one step, because the ring copies all of them at its end

OnResult = Callable[[Any], None]


def takes_runs(store: ChannelStore, channel_id: bytes, epoch: int) -> bool:
    """Whether `InProcessPutStream` can put into the channel: no put may wait for room. Raises as `find`."""
    hosted = find_here(store, channel_id, epoch)
    return hosted is not None and not hosted.puts.may_wait


def _find(store: ChannelStore, channel_id: bytes, epoch: int) -> HostedChannel:
    """A channel in which no put waits for room. Raises Unavailable, and the errors of `find`."""
    hosted = find_here(store, channel_id, epoch)
    if hosted is None or hosted.puts.may_wait:
        raise Unavailable("the channel takes puts only over a stream now; the client opens one")
    return hosted


class _StatedAck(NamedTuple):
    """The acknowledgement that a producer wants for each run (`WantedAck`)."""

    ack: int
    wait_nanos: int | None = None


class InProcessPutStream:
    """A stream of runs. Any thread may call `send` and `cancel`, which do not wait. The host's thread puts the runs.

    A payload that is a run of its own stays the object that was put.
    """

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        store: ChannelStore,
        channel: tuple[bytes, int],
        producer: tuple[int, int],
        on_acks: OnResult,
        on_end: OnResult,
    ) -> None:
        """`channel`: its id and epoch. `producer`: its id, and the number of the `Ack` that it wants.

        `on_acks` gets each PutResponse, and `on_end` the error that ends the stream.
        """
        self._loop, self._store, self._channel = loop, store, channel
        self._producer_id, self._stated = producer[0], _StatedAck(producer[1])
        self._on_acks, self._on_end = on_acks, on_end
        self._sent: deque[RunToPut] = deque()  # the producer bounds the unacknowledged bytes
        self._held = HeldAcks(self._on_due, self._spawn)  # the acks that wait for the disk, and the acks after them
        self._tasks: set[asyncio.Task[None]] = set()
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
        with suppress(RuntimeError):  # the loop has closed
            self._loop.call_soon_threadsafe(self._drop_held)

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
        self._report_acks(acks)
        self._schedule_rest()  # while `_is_called` was set, `send` only added its runs

    def _schedule_rest(self) -> None:
        """Put the sent runs that are left, unless too many acks wait for the disk."""
        if self._sent and not self._is_called and len(self._held) < HELD_ACKS_MAX:
            self._is_called = True
            self._loop.call_soon(self._put_sent)

    def _report_acks(self, acks: Sequence[pb.PutAck | HeldAck]) -> None:
        """Report the acks in order, as soon as they are due."""
        now, later = ([], acks) if self._held else _split(acks)
        for ack in later:
            self._held.add(ack)
        if now and not self.is_over:
            self._on_acks(pb.PutResponse(acks=now))

    def _on_due(self, _in_this_turn: bool) -> None:
        """Report the acks that have become due, and go on with the runs that have waited for room."""
        acks = self._held.take(HELD_ACKS_MAX)
        if acks and not self.is_over:
            self._on_acks(pb.PutResponse(acks=acks))
        self._schedule_rest()

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = self._loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    def _drop_held(self) -> None:
        self._held.close()

    def _put_all(self) -> list[pb.PutAck | HeldAck]:
        until_s, left_bytes, acks = time.monotonic() + STEP_SECONDS_MAX, STEP_BYTES_MAX, list[pb.PutAck | HeldAck]()
        acks_max = HELD_ACKS_MAX - len(self._held)
        try:
            hosted = _find(self._store, *self._channel)
        except StampedeError as error:
            return [self._refused(run, error) for run in self._taken()]
        # the archive notes the instant at which the host accepted each run
        with nullcontext() if hosted.recording is not None else hosted.puts.announced_together():
            while self._sent and not self.is_over and len(acks) < acks_max:
                if acks and (left_bytes <= 0 or time.monotonic() >= until_s):
                    break
                run = self._sent.popleft()
                left_bytes -= sum(map(len, run.encoded))
                acks.append(self._put(hosted, run))
        return acks

    def _taken(self) -> Iterator[RunToPut]:
        while self._sent:
            yield self._sent.popleft()

    def _put(self, hosted: HostedChannel, run: RunToPut) -> pb.PutAck | HeldAck:
        if self._refusal is not None:
            return self._refused(run, self._refusal)
        try:
            check_wanted(hosted, self._stated.ack)
            ack = put_now(hosted, self._incoming(run), self._stated.ack, self._store.now())
        except StampedeError as error:
            return self._refused(run, error)
        return held_ack(ack, hosted, self._stated, time.monotonic())

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


def _split(acks: Sequence[pb.PutAck | HeldAck]) -> tuple[list[pb.PutAck], Sequence[pb.PutAck | HeldAck]]:
    """The first acks that wait for nothing, and the rest."""
    now: list[pb.PutAck] = []
    for ack in acks:
        if not isinstance(ack, pb.PutAck):
            break
        now.append(ack)
    return now, acks[len(now) :]


def _joined(encoded: Sequence[bytes]) -> tuple[bytes, None]:
    return b"".join(encoded), None


def _referenced(encoded: Sequence[bytes], plain: PlainRun) -> tuple[ReferencedBody, RunColumns]:
    times = None if plain.time is None else (plain.time,)
    durations = None if plain.duration is None else (plain.duration,)
    return ReferencedBody(encoded, encoded[-1], NO_ATTRIBUTES, ""), RunColumns(times, durations, (plain.length,))
