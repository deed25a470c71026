"""One run that a producer puts into a channel, from its arrival until its ack."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.runs import RunColumns, parse_run, seal_run, select_items
from stampede_rt_channel_host.channels.limits.memory import own_bytes
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES, Body, Offer, PutOutcome, ReferencedBody
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunProgress

LOCAL_WRITER = "@localhost"  # a put in the process of an embedded host has no credential


class IncomingRun:
    """One run that a producer puts, until the run has its ack. `wait_nanos` None: the run may wait without limit."""

    __slots__ = (
        "_done", "_encoded", "_timer", "ack", "caller_name", "first_number", "items", "offer", "producer_id",
        "progress", "wait_nanos", "writer",
    )  # fmt: skip

    def __init__(
        self,
        encoded: bytes | memoryview | ReferencedBody,
        *,
        columns: RunColumns | None = None,
        producer_id: int,
        first_number: int,
        wait_nanos: int | None,
        caller_name: str = "",
        writer: str = LOCAL_WRITER,
    ) -> None:
        """`caller_name`: see `RetryWindow.record`. `writer`: the caller's name for `Writers`.

        `columns`: the columns of a run of one item that is not encoded yet.

        Raises MalformedRun, or ItemTooLarge for an item larger than any channel can hold.
        """
        if columns is None:
            assert not isinstance(encoded, ReferencedBody), "such a run comes with its columns"
            columns = parse_run(encoded)
        self.offer = Offer(times=columns.times, durations=columns.durations, lengths=columns.lengths)
        self.items = len(columns.lengths)
        self.progress = RunProgress(self.items)
        self.producer_id = producer_id
        self.first_number = first_number
        self.wait_nanos = wait_nanos
        self.caller_name = caller_name
        self.writer = writer
        self.ack: pb.PutAck | None = None
        self._encoded = encoded
        self._done: asyncio.Future[None] | None = None
        self._timer: asyncio.TimerHandle | None = None

    def keep(self) -> None:
        """Copy the run's bytes if they are a view of the request, because the run has to wait."""
        if not isinstance(self._encoded, ReferencedBody):
            self._encoded = own_bytes(self._encoded)

    @property
    def charged_bytes(self) -> int:
        """The bytes that the host's memory budget counts for the run."""
        return len(self._encoded) + self.items * ITEM_OVERHEAD_BYTES

    def seal(self, first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> Body:
        """Note that the core accepts items, and return the body to store for these items (see `core.Seal`)."""
        rest = range(self.progress.judged_items, self.items)
        positions = rest if kept is None else [rest[position] for position in kept]
        self.progress.accept(positions[0], first_seq, len(positions), stamped_time)
        stamps = None if stamped_time is None else (stamped_time,) * len(positions)
        if isinstance(self._encoded, ReferencedBody):
            return self._encoded.followed_by(seal_run(b"", first_seq, stamps))
        encoded = self._encoded if len(positions) == self.items else select_items(self._encoded, positions)
        return seal_run(encoded, first_seq, stamps)

    def take_outcome(self, outcome: PutOutcome, now: int) -> bool:
        """Note which items the core has refused, and which have to wait. Returns True if no item has to wait."""
        offered = self.progress.judged_items
        for one in outcome.rejections:
            self.progress.refuse(offered + one.index, one.error)
        if outcome.waiting is None:
            self.progress.judged_items = self.items
            return True
        self.progress.judged_items += outcome.waiting
        self.offer = self.offer.rest(outcome.waiting, now)
        return False

    def resume(self, known: RunOutcome, now: int) -> None:
        """Continue a repeated run: offer only the items that were neither accepted nor refused before."""
        offered = self.progress.judged_items
        if self.progress.resume(known) and not known.is_whole:
            self.offer = self.offer.rest(known.judged_items - offered, now)

    @property
    def undecided_items(self) -> int:
        """The number of items that are neither accepted nor refused yet."""
        return self.items - self.progress.judged_items

    def refuse_rest(self, error: StampedeError) -> None:
        """Refuse the items that are neither accepted nor refused yet."""
        for index in range(self.progress.judged_items, self.items):
            self.progress.refuse(index, error)
        self.progress.judged_items = self.items

    def finish(self, ack: pb.PutAck) -> None:
        """Store the run's ack, and wake the coroutine that waits for the ack."""
        self.ack = ack
        self.forget_time()
        if self._done is not None and not self._done.done():
            self._done.set_result(None)

    def forget_time(self) -> None:
        """Stop the timer of the run's waiting time."""
        if self._timer is not None:
            self._timer.cancel()

    async def wait(self, give_up: Callable[[IncomingRun], None]) -> pb.PutAck:
        """Wait until the run has its ack.

        Calls `give_up` at the end of the waiting time; `give_up` must finish the run.
        """
        loop = asyncio.get_running_loop()
        if self.wait_nanos is not None:
            self._timer = loop.call_later(self.wait_nanos / 1e9, give_up, self)
        if self.ack is None:
            self._done = loop.create_future()
            await self._done
        assert self.ack is not None, "finish sets it"
        return self.ack
