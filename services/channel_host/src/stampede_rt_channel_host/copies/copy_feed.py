"""The copy's side of the stream that feeds it (paper, section 4.1: proxies)."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import grpc

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import raw_run_pb2
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.new_channels import NewCopy
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.cut_floors import floor_from_message
from stampede_rt_channel_host.cluster.task_failures import first_failure
from stampede_rt_channel_host.copies.fed_items import encode_answer
from stampede_rt_channel_host.copies.fed_responses import FedResponse
from stampede_rt_channel_host.copies.feed_calls import BROKEN_AFTER_SECONDS, feed_over, plain_error
from stampede_rt_channel_host.copies.messages import (
    cleared_of,
    facts_after_runs,
    facts_of,
    losses_of,
    place_to,
    record_in,
    run_of,
    run_of_item,
)
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.copies.request_writer import RequestWriter
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES, FedChannel, FedItem, Losses, Run
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_runtime.sockets.dialing import HostStream

WINDOW_BYTES = 4 * 2**20  # how far the source may be ahead of the copy, unless the copy states less
GRANTS = 4  # the copy grants its window in this many parts; each request costs the source a message
REQUEST_SECONDS = 0.5  # the copy sends a request at least this often, and the source answers it
REPLICA_REQUEST_SECONDS = 0.2  # a replica that is silent for a second is out of sync
RUNS_PER_TURN = 64  # the storing of a run takes about 15 us


class CopyFeed:
    """One stream from a source to the copy of one channel. `target` is the gatekeeper of this host."""

    def __init__(
        self, store: ChannelStore, record: RecordedChannel, state: CopyState, host_id: bytes, target: str,
        bytes_per_second: int = 0, *, owner_facts: bool = False, window_bytes: int = WINDOW_BYTES,
    ) -> None:  # fmt: skip
        """`bytes_per_second`: the most that the copy takes; 0: without a limit. `owner_facts`: the source also
        sends the facts that only the owner has, so that the copy can become the owner (`FedChannel.as_owner`).
        `window_bytes`: how far the source may be ahead of the copy.
        """
        self._store = store
        self._record = record
        self._state = state
        self._host_id = host_id
        self._target = target
        self._bytes_per_second = bytes_per_second
        self._owner_facts = owner_facts
        self._period_s = REPLICA_REQUEST_SECONDS if owner_facts else REQUEST_SECONDS
        self._window_bytes, self._grant_bytes = window_bytes, window_bytes // GRANTS
        self._granted = 0
        self._sent_nanos = 0  # the copy's clock in the last request
        self._reported_seq = 0  # the last request has said that this host holds all items before this seq
        self._last_received_s = 0.0  # when the last message of the source came
        self._owes_request = False  # after this message of the source, a request is due immediately
        self._requests = RequestWriter(self._wait_seconds, self._check_source, self._next_request)
        self._may_grant_s = 0.0  # the time at which the copy may grant more, because of `bytes_per_second`
        self.is_opened = False  # whether the source has opened the feed

    async def run(self, source: FeedSource, channel: grpc.aio.Channel) -> None:
        """Feed the copy until the stream breaks. Raises the error that broke it."""
        call = feed_over(channel)
        try:
            await self.run_over(call, source)
        finally:
            call.cancel()

    async def run_over(self, call: Any, source: FeedSource) -> None:
        """Feed the copy over a stream that no other feed uses now.

        If the feed belongs to a move of the channel, returns when the source says that this move is over. Raises the
        error that broke the stream. The caller ends the stream.
        """
        self._state.source_host_id, self._granted = source.host_id, self._window_bytes
        try:
            async with asyncio.timeout(BROKEN_AFTER_SECONDS):
                await call.write(self._request(self._opening(source)))
            # the silence of the source counts from here on: the connection alone may have taken seconds
            self._last_received_s = asyncio.get_running_loop().time()
            async with asyncio.TaskGroup() as sides:
                self._requests.open(call, sides)
                try:
                    await self._read_all(call, source)
                finally:
                    self._requests.stop()
                await self._requests.aclose()
        except BaseExceptionGroup as group:
            raise plain_error(first_failure(group), source.target) from group
        except (grpc.RpcError, asyncio.InvalidStateError, TimeoutError) as error:
            raise plain_error(error, source.target) from error

    def _opening(self, source: FeedSource) -> pb.FeedOpen:
        held = self._held()
        if held is not None and self._owner_facts and _core(held).owner_facts is None:
            held = None  # a proxy until now, which does not know the owner's facts
        return pb.FeedOpen(
            channel_id=self._record.channel_id,
            epoch=source.epoch,
            host_id=self._host_id,
            target=self._target,
            place=None if held is None else place_to(_core(held).place, held.epoch),
            owner_facts=self._owner_facts,
            takes_puts=self._owner_facts,
            takes_items=True,
            takes_runs=True,
        )

    def _may_report(self) -> bool:
        """Whether the source may count the items of this copy. Without its lease, this host does not become the owner
        even if the copy is a replica in sync. The directory drops the copy before the source learns of it.
        """
        return not self._owner_facts or self._store.lease_held()

    def _held(self) -> HostedChannel | None:
        return self._store.copies.of(self._record.channel_id)

    def _request(self, opening: pb.FeedOpen | None = None, *, grants: bool = True) -> pb.FeedRequest:
        if not self._may_report():
            raise Unavailable(f"this host has no lease, so its copy of channel {self._record.name} does not count")
        held, granted = self._held(), self._granted if grants else 0
        self._granted -= granted
        self._reported_seq = held.channel.next_seq if self.is_opened and held is not None else 0
        return pb.FeedRequest(
            open=opening,
            credit_bytes=granted,
            sent_nanos=self._clock_nanos(is_new=granted >= self._grant_bytes),
            subscriptions=0 if held is None else len(held.subscriptions),
            ready=self._state.is_ready,
            held_next_seq=self._reported_seq,
        )

    def _clock_nanos(self, *, is_new: bool) -> int:
        """The copy's clock for a request. The source answers each request that has a new time. Therefore the reports of
        progress repeat the last time for half a period.
        """
        now = self._state.steady_nanos()
        if is_new or now - self._sent_nanos >= self._period_s * 1e9 / 2:
            self._sent_nanos = now
        return self._sent_nanos

    def _wait_seconds(self) -> float:
        """The time until a request is due, although no message of the source causes it."""
        wait_s = self._may_grant_s - asyncio.get_running_loop().time()
        return min(self._period_s, wait_s) if wait_s > 0 else self._period_s

    def _check_source(self) -> None:
        """Raises TimeoutError if the source is silent."""
        if asyncio.get_running_loop().time() - self._last_received_s > BROKEN_AFTER_SECONDS:
            raise TimeoutError

    def _next_request(self, grant_bytes_min: int = 0) -> pb.FeedRequest:
        """The request that is due. It grants at least `grant_bytes_min`, or nothing: a grant is work for the source."""
        now_s = asyncio.get_running_loop().time()
        grants = now_s >= self._may_grant_s and self._granted >= grant_bytes_min
        if grants and self._bytes_per_second:
            self._may_grant_s = now_s + self._granted / self._bytes_per_second
        self._requests.note_request()
        self._owes_request = False
        return self._request(grants=grants)

    async def _read_all(self, call: Any, source: FeedSource) -> None:
        loop = asyncio.get_running_loop()
        while isinstance(response := await call.read(), FedResponse | FedItem):
            self._last_received_s = loop.time()
            await self._take(response)
            if isinstance(response, FedResponse) and response.fields.move_over:
                return
            if self._owes_request:
                await self._requests.write()  # not the writer's task: puts at the source wait for the request
            if isinstance(call, HostStream):
                call.answer_in_same_turn(partial(self._take_in_same_turn, call))
        raise Unavailable(f"the source at {source.target} has ended the feed")

    def _take_in_same_turn(self, call: Any, response: FedResponse | FedItem) -> bool:
        """Take a short part, and answer it, in the turn of the event loop in which it comes: puts wait for the answer.

        Returns False for any other message.
        """
        if isinstance(response, FedItem):
            return self._take_item_in_same_turn(call, response)
        if response.fields.HasField("opened") or len(response.runs) > RUNS_PER_TURN or self._requests.is_busy:
            return False
        self._last_received_s = asyncio.get_running_loop().time()
        self._follow(response.fields)
        state, write = response.fields.state, call.write_now
        is_new = self._owner_facts and self._state.caught_up and state.next_seq != self._reported_seq
        answer = partial(self._report, write, state.next_seq) if write is not None and is_new else None
        self._store_last(state, [run_of(bytes(body)) for body in response.runs], answer)
        if self._owes_request and write is not None:
            write(self._next_request())
        elif self._owes_request:
            self._requests.wake()
        return True

    def _take_item_in_same_turn(self, call: Any, fed: FedItem) -> bool:
        write = None if self._requests.is_busy or not self._may_report() else call.write_now
        if write is None or not self._state.caught_up or self._granted >= self._grant_bytes:
            return False
        self._last_received_s = asyncio.get_running_loop().time()
        self._store_item(fed, partial(write, encode_answer(fed.item.end_seq)) if self._owner_facts else None)
        return True

    def _store_item(self, fed: FedItem, answer: Callable[[], None] | None = None) -> None:
        """Store a run of the feed that came alone. `answer`: see `_store_runs`."""
        held, now, item = self._held(), self._store.now(), fed.item
        if held is None:
            raise Unavailable("the copy was dropped")
        core, run = _core(held), run_of_item(item)
        held.make_room(len(item.body) + item.items * ITEM_OVERHEAD_BYTES)
        core.check_item(fed)
        if answer is not None:
            self._reported_seq = item.end_seq
            answer()
        core.apply_item(fed, run, now)
        held.fed_part(now)
        self._state.source_next_seq = item.end_seq
        self._note_place(held, item.charge_bytes)

    def _report(self, write: Callable[[pb.FeedRequest], None], next_seq: int) -> None:
        """Tell the source that this host holds all items before `next_seq`, because it stores them in this step."""
        request = self._next_request(self._grant_bytes)
        request.held_next_seq = self._reported_seq = next_seq
        write(request)

    async def _take(self, response: FedResponse | FedItem) -> None:
        if isinstance(response, FedItem):
            self._store_item(response)
            return
        self._follow(response.fields)
        await self._apply(response.fields.state, response.runs)

    def _follow(self, response: raw_run_pb2.RawFeedResponse) -> None:
        """Take over the channel as the source knows it, if the response describes it."""
        state = response.state
        if response.HasField("opened"):
            self._begin(state, begins_anew=response.opened.begins_anew, losses=losses_of(response.opened))
            self.is_opened = True
        elif state.HasField("channel"):
            self._update(record_in(state, self._record))

    def _begin(self, state: pb.FeedState, *, begins_anew: bool, losses: Losses) -> None:
        """Take over the channel as the source knows it. Begin an empty copy if the present one cannot continue."""
        record, held = record_in(state, self._record), self._held()
        is_other = held is None or begins_anew or held.record.incarnation != record.incarnation
        if held is None or is_other or (self._owner_facts and _core(held).owner_facts is None):
            self._state.caught_up = False
            self._store.copies.begin(record, NewCopy(self._state, losses, self._owner_facts))
        else:
            self._update(record)

    def _update(self, record: RecordedChannel) -> None:
        held = self._held()
        if held is not None:
            held.update(record)

    async def _apply(self, state: pb.FeedState, bodies: Sequence[bytes | memoryview]) -> None:
        """Apply one part. Stores a few runs in each turn of the event loop, and the source's state with the last
        runs.
        """
        rest = bodies
        while len(rest) > RUNS_PER_TURN:
            some, rest = [run_of(bytes(body)) for body in rest[:RUNS_PER_TURN]], rest[RUNS_PER_TURN:]
            end_seq = some[-1].first_seq + len(some[-1])
            self._granted += self._store_runs(some, **self._beginning_of(state), next_seq=end_seq)
            # the rest of the part begins here, and has no facts of its own
            state.first_seq = end_seq
            state.ClearField("cleared")
            state.ClearField("owner")
            state.ClearField("put")
            await asyncio.sleep(0)
        self._store_last(state, [run_of(bytes(body)) for body in rest])

    def _store_last(self, state: pb.FeedState, runs: Sequence[Run], answer: Callable[[], None] | None = None) -> None:
        """Apply the last runs of a part, and then the source's state. `answer`: see `_store_runs`."""
        beginning = self._beginning_of(state)
        rest = facts_after_runs(state)
        charge_bytes = self._store_runs(runs, answer, **beginning, next_seq=state.next_seq, **rest)
        self._note(state, charge_bytes)

    def _beginning_of(self, state: pb.FeedState) -> dict[str, Any]:
        """The fields of a part that the copy applies before its runs."""
        owner_part = facts_of(state, self._store.now())
        return {"first_seq": state.first_seq, "cleared": cleared_of(state), "owner_part": owner_part}

    def _store_runs(self, runs: Sequence[Run], answer: Callable[[], None] | None = None, **part: Any) -> int:
        """Apply a part of the feed with `runs`. Returns the bytes that they cost the source's credit.

        Calls `answer` as soon as nothing can fail any more, and stores the runs afterwards: puts wait for the answer.
        """
        held, now = self._held(), self._store.now()
        if held is None:
            raise Unavailable("the copy was dropped")
        held.make_room(sum(len(run.body) + len(run) * ITEM_OVERHEAD_BYTES for run in runs))
        if answer is not None:
            _core(held).check_place(part["first_seq"])
            answer()
        _core(held).apply(runs=runs, now=now, **{"collection": None, "advance": None} | part)
        held.fed_part(now)
        return sum(run.payload_bytes(0, len(run)) + len(run) * ITEM_OVERHEAD_BYTES for run in runs)

    def _note(self, state: pb.FeedState, charge_bytes: int) -> None:
        copy = self._state
        copy.as_of_nanos = state.heard_nanos - state.staleness_nanos
        copy.source_next_seq = state.source_next_seq
        copy.merge_floors(map(floor_from_message, state.floors))
        self._note_place(self._held(), charge_bytes)

    def _note_place(self, held: HostedChannel | None, charge_bytes: int) -> None:
        """Note that the copy has stored a part. `charge_bytes`: its cost to the source's credit."""
        copy = self._state
        if not copy.caught_up and held is not None and held.channel.next_seq >= copy.source_next_seq:
            copy.caught_up = self._owes_request = True  # the source may now send readers to this copy
        copy.note_progress()
        if self._owner_facts and held is not None and held.channel.next_seq != self._reported_seq:
            self._owes_request = True  # puts wait until the replica reports this part
        self._granted += charge_bytes
        self._owes_request |= self._granted >= self._grant_bytes


def _core(held: HostedChannel) -> FedChannel:
    assert isinstance(held.channel, FedChannel), "the store has found a copy"
    return held.channel
