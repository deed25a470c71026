"""Serves one stream of puts: judges and acks runs in order.

The loop that reads the requests writes the ack of a single put itself, because its caller waits for it. Over a socket
even that loop need not run: the stream takes a request of a few runs in the turn of the event loop in which its bytes
come (decision 0164).
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NamedTuple

from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument, Overloaded, PermissionDenied, StampedeError
from stampede_rt.status import from_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.delivered import RUN_ITEMS_MAX
from stampede_rt.wire.request_pieces import PIECE_TAG
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.puts.ack_writer import RUNS_PER_TURN, AckWriter
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.puts.held_acks import HeldAck
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.put_requests import Put, read_request
from stampede_rt_channel_host.channels.puts.puts import ChannelPuts, check_number
from stampede_rt_channel_host.channels.puts.read_ahead import ReadAhead, left_nanos
from stampede_rt_channel_host.channels.puts.wanted_acks import check_disk, check_wanted, held_ack
from stampede_rt_channel_host.channels.puts.whole_requests import WholeRequests
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.channels.subscriptions.reader_drops import UNNAMED
from stampede_rt_runtime.access.control import current_account, current_work, own_name, request_rights, shown_name
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.rpc import Context, answer_in_same_turn

REQUEST_BYTES_MAX = 4 * 2**20  # the runs of a request with several runs
SAME_TURN_RUNS_MAX = 16  # the most that one turn answers; producers join at most this many in a request
SAME_TURN_TIMED_ITEMS_MAX = RUNS_PER_TURN * RUN_ITEMS_MAX  # the channel takes up to 6 us to sort one in
_FRAMING_BYTES_MAX = 4096  # the fields of such a request, without the runs


class _ReceivedRequest(NamedTuple):
    """The runs of one request that the host has not yet judged, and the monotonic time at which the request came.

    `too_much`: the request is larger than allowed. The host then refuses all its runs. `is_single`: it names its
    channel and has one run, as the requests of a caller that waits for each ack.
    """

    puts: deque[Put]
    received_s: float
    too_much: bool
    is_single: bool

    def keep(self) -> int:
        """Copy each run, so that the request is no longer kept in memory. Returns the sum of the runs' bytes."""
        for _ in range(len(self.puts)):
            self.puts.append(self.puts.popleft().kept())
        return sum(len(put.run) for put in self.puts)


class PutStream:
    """Serves one stream. A run that waits for room blocks the later runs.

    The waiting time of each run counts from the arrival of its request. If this time has passed when the run's turn
    comes, the host accepts or refuses the run without a further wait.
    """

    def __init__(self, store: ChannelStore, context: Context, stream: OpenStream) -> None:
        self._store = store
        self._context = context
        self._stream = stream
        self._channel_id = b""
        self._epoch = 0
        self._producer_id = 0
        self._acks: AckWriter  # made when the stream is served
        self._refused: tuple[int, StampedeError] | None = None  # the run that the producer sends again, and the reason
        self._judged_at: HostedChannel | None = None  # the channel of the latest run
        self._account = current_account()
        self._caller_name = own_name()
        self._writer = shown_name() or UNNAMED
        self._rights = request_rights(_lose)
        self._work = current_work()
        self._whole = WholeRequests(context.read, store.memory.requests, self._account)
        self._requests = ReadAhead(self._whole, store.memory, self._account)

    async def run(self) -> None:
        """Serve until the caller has closed its side and every run is acked.

        Raises InvalidArgument for an invalid request.
        """
        self._acks = AckWriter(self._context, _encoded, self._stream.spawn)
        answer_in_same_turn(self._context, self._take_in_same_turn)
        try:
            while (received := self._read_request(*await self._requests.next())) is not None:
                await self._take(received)
            await self._acks.finish()
        finally:
            self._acks.close()
            self._requests.close()

    def _read_request(self, raw: Any, received_s: float) -> _ReceivedRequest | None:
        """Decode a request; None at the end of the stream."""
        if raw is EOF:
            return None
        request = read_request(raw)
        if request.channel_id:
            self._channel_id, self._epoch = request.channel_id, request.epoch
            self._producer_id, self._refused = request.producer_id, None
        too_much = len(request.puts) > 1 and len(raw) > REQUEST_BYTES_MAX + _FRAMING_BYTES_MAX
        is_single = bool(request.channel_id) and len(request.puts) == 1
        return _ReceivedRequest(request.puts, received_s, too_much, is_single)

    def _take_in_same_turn(self, raw: bytes | memoryview, write: Callable[[bytes], None]) -> bool:
        """Judge the few runs of a request, which surely need not wait for room, and write their acks as soon as they
        are due.

        Returns False for any other message.
        """
        is_busy = not self._acks.is_idle or self._whole.is_joining or self._requests.is_ahead
        if is_busy or raw[:1] == PIECE_TAG:
            return False
        try:
            request = read_request(raw)
            names = bool(request.channel_id)
            channel_id, epoch = (request.channel_id, request.epoch) if names else (self._channel_id, self._epoch)
            hosted = self._store.find(channel_id, epoch)
            if hosted.puts.may_wait or not _are_few(request.puts):
                return False
        except StampedeError:  # the loop that reads the requests raises the same error
            return False
        if names:
            self._channel_id, self._epoch, self._producer_id = channel_id, epoch, request.producer_id
            self._refused = None
        acks = self._judge_together(request.puts, time.monotonic(), hosted)
        due = [ack for ack in acks if isinstance(ack, pb.PutAck)]
        if len(due) == len(acks):
            write(_encoded(due))
        else:
            self._acks.hold(acks)
        return True

    async def _take(self, received: _ReceivedRequest) -> None:
        if self._work.must_wait:
            await self._work.turn()
        self._requests.release()  # the runs are judged without a wait; a run that has to wait is counted then
        self._work.spend_read()
        for judged in self._judge_replicated(received):
            await self._acks.add(judged)
        while received.puts:
            ack: pb.PutAck | HeldAck
            if received.too_much:
                ack = _refuse_size(received.puts.popleft(), self._store.now())
            else:
                ack = await self._put(received)
            await self._acks.add(ack)
            if received.puts and len(received.puts) % RUNS_PER_TURN == 0:
                await asyncio.sleep(0)
        if received.is_single:
            await self._acks.write()
            return
        self._acks.wake()
        await asyncio.sleep(0)  # let the writer send this ack before the next read begins

    def _judge_replicated(self, received: _ReceivedRequest) -> list[pb.PutAck | HeldAck]:
        """The acks of the runs, if they go to replicas together. Otherwise judges no run."""
        if received.too_much or len(received.puts) < 2 or not _are_few(received.puts):
            return []
        try:
            hosted = self._store.find(self._channel_id, self._epoch)
        except StampedeError:  # the ack of each run tells the error
            return []
        if hosted.replication is None or hosted.puts.may_wait:
            return []
        puts = [*received.puts]
        received.puts.clear()
        return self._judge_together(puts, received.received_s, hosted)

    def _judge_together(
        self, puts: Iterable[Put], received_s: float, hosted: HostedChannel
    ) -> list[pb.PutAck | HeldAck]:
        """The acks of runs whose channel lets no put wait for room."""
        with _announced_together(hosted):
            return [self._judge_now(put, received_s, hosted) for put in puts]

    def _judge_now(self, put: Put, received_s: float, hosted: HostedChannel) -> pb.PutAck | HeldAck:
        """The ack of a run whose channel lets no put wait for room."""
        ack = self._judge(put, received_s, hosted)
        assert isinstance(ack, pb.PutAck), "the channel lets no put wait"
        self._note_refusal(ack)
        return held_ack(ack, hosted, put, received_s)

    async def _put(self, received: _ReceivedRequest) -> pb.PutAck | HeldAck:
        """The ack of the first run. Waits while the run waits for room."""
        put = received.puts.popleft()
        judged = self._judge(put, received.received_s)
        ack = judged if isinstance(judged, pb.PutAck) else await self._wait(*judged, received)
        self._note_refusal(ack)
        return ack if self._judged_at is None else held_ack(ack, self._judged_at, put, received.received_s)

    def _judge(
        self, put: Put, received_s: float, hosted: HostedChannel | None = None
    ) -> pb.PutAck | tuple[IncomingRun, HostedChannel]:
        """The ack of a run, or the run and its channel if the run has to wait for room.

        `hosted`: the channel, if it was found in this turn of the event loop.
        """
        now = self._store.now()
        if self._refused is not None and put.first_number > self._refused[0]:
            return refused(put.first_number, 0, self._refused[1], now)
        run: IncomingRun | None = None
        try:
            check_number(self._producer_id, put.first_number)
            if not self._channel_id:
                raise InvalidArgument(
                    "the put names no channel; set channel_id and epoch in the stream's first request"
                )
            hosted = self._judged_at = hosted or self._store.find(self._channel_id, self._epoch)
            self._rights.check(AccessVerb.PUT, AccessKind.CHANNEL, hosted.record.name)
            check_wanted(hosted, put.ack)
            try:
                run = self._read(put, received_s)
            except StampedeError as error:
                hosted.puts.count_unread(len(put.run), error, now)
                raise
            if hosted.recording is not None:
                check_disk(hosted, put.ack, is_repeated=hosted.puts.repeats(run, now))
            return hosted.puts.put(run, now) or (run, hosted)
        except StampedeError as error:
            return refused(put.first_number, run.items if run else 0, error, now)

    def _note_refusal(self, ack: pb.PutAck) -> None:
        """Note whether the producer sends the run of this ack again. Until then the stream accepts none of its later
        runs, because they would overtake that run. A request that names its channel begins anew.
        """
        error = from_error_message(ack.error) if self._producer_id and ack.HasField("error") else None
        if error is not None and error.retryable:
            self._refused = self._refused or (ack.first_number, error)
        elif self._refused is not None and ack.first_number == self._refused[0]:
            self._refused = None

    async def _wait(self, run: IncomingRun, hosted: HostedChannel, received: _ReceivedRequest) -> pb.PutAck:
        """Wait for the ack of a run that waits for room.

        Meanwhile the host keeps the bytes of this run and of the later runs of its request, but not the request itself,
        and counts them as memory.
        """
        self._acks.wake()  # let the writer send the earlier acks meanwhile
        run.keep()
        puts, waiting = hosted.puts, (hosted.puts, run)
        self._rights.hold(waiting, AccessVerb.PUT, AccessKind.CHANNEL, hosted.record.name)
        try:
            with self._account.waiting(run.charged_bytes), self._requests.keeping(received.keep()):
                return await run.wait(puts.give_up)
        except Overloaded as error:
            return puts.refuse(run, error)
        finally:
            self._rights.release(waiting)
            puts.withdraw(run)

    def _read(self, put: Put, received_s: float) -> IncomingRun:
        wait_nanos = None if put.wait_nanos is None else left_nanos(put.wait_nanos, received_s)
        return IncomingRun(
            put.run,
            producer_id=self._producer_id,
            first_number=put.first_number,
            wait_nanos=wait_nanos,
            caller_name=self._caller_name,
            writer=self._writer,
        )


def _encoded(acks: list[pb.PutAck]) -> bytes:
    return pb.PutResponse(acks=acks).SerializeToString()


def _are_few(puts: Collection[Put]) -> bool:
    """Whether one turn of the event loop may judge these runs."""
    if len(puts) <= RUNS_PER_TURN:
        return len(puts) > 0
    return len(puts) <= SAME_TURN_RUNS_MAX and sum(put.timed_items for put in puts) <= SAME_TURN_TIMED_ITEMS_MAX


def _announced_together(hosted: HostedChannel) -> AbstractContextManager[None]:
    """A block of puts. If the channel has a ring or replicas, these get all its runs at the end of the block.
    Otherwise readers learn of each run as it comes.
    """
    repeats = (hosted.ring is not None or hosted.replication is not None) and hosted.recording is None
    return hosted.puts.announced_together() if repeats else nullcontext()


def _lose(waiting: tuple[ChannelPuts, IncomingRun], error: PermissionDenied) -> None:
    """Refuse a run that waits, because the caller has lost a right."""
    puts, run = waiting
    puts.refuse(run, error)


def _refuse_size(put: Put, now: int) -> pb.PutAck:
    error = InvalidArgument(
        f"the request is larger than {REQUEST_BYTES_MAX} bytes and holds several runs; send fewer runs in one request"
    )
    return refused(put.first_number, 0, error, now)
