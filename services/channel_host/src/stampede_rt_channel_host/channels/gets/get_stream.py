"""Serves one stream of gets: many calls at the same time, each with its own answer.

A get has an asyncio task of its own only if its answer is long, or if it waits for a group.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Any

from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument, Overloaded, PermissionDenied, StampedeError
from stampede_rt.status import to_error_message
from stampede_rt_channel_host.channels.frames import get_error, get_responses
from stampede_rt_channel_host.channels.gets.archived_gets import read_recorded
from stampede_rt_channel_host.channels.gets.get_plans import REQUEST_BYTES_MAX, GetCall, GetPlan, GetPlans, check_length
from stampede_rt_channel_host.channels.gets.get_summaries import kept_bytes_of, past_to_message, summary_of
from stampede_rt_channel_host.channels.gets.open_get import OpenGet
from stampede_rt_channel_host.channels.gets.outbox import Outbox
from stampede_rt_channel_host.channels.gets.waiting_get import Outcome, WaitingGet
from stampede_rt_channel_host.channels.gets.waiting_gets import GETS_PER_PIECE
from stampede_rt_channel_host.channels.group_access import GroupAccess, GroupReadParams
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.hosted_copies import refusal_of
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.channel import (
    Pieces,
    ReadAnswer,
    UnfinishedWork,
    WakeAt,
    emptying,
    first_of,
)
from stampede_rt_runtime.access.control import current_account, current_work, request_rights
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context, answer_in_same_turn

CALLS_MAX = 1024  # calls under way on one stream
POLLS_PER_PIECE = 4
"""The most gets that one piece polls again when there is room for their answers. One poll takes up to a millisecond."""


class GetStream:
    """Serves one stream. A call is under way until its last message is written or the caller cancels it."""

    def __init__(self, store: ChannelStore, groups: GroupAccess, context: Context, stream: OpenStream) -> None:
        self._store = store
        self._groups = groups
        self._context = context
        self._stream = stream
        self._account = current_account()
        self._work = current_work()
        # by call id: the get that waits, or the task that makes the answer; None: the answer is still to be sent
        self._calls: dict[int, WaitingGet | asyncio.Task[None] | None] = {}
        self._plans = GetPlans()
        self._idle = asyncio.Event()  # set when the last call has ended
        self._outbox = Outbox(context, stream, self._ended, self._room_came, store.scheduler.begin, self._account)
        # the number of calls that the caller's quota counts for this stream
        self._under_way = self._account.charge_for(Quota.WAITING_CALLS)
        self._held_back: dict[int, OpenGet] = {}  # released gets that wait for room in the outbox
        self._rights = request_rights(self._lose)
        self._is_polling = False  # whether `_polling_again` is under way

    async def run(self) -> None:
        """Serve until the caller has closed its side and every call is answered.

        Raises InvalidArgument if a request cannot be decoded.
        """
        answer_in_same_turn(self._context, self._take_in_same_turn)
        try:
            while (raw := await self._context.read()) is not EOF:
                check_length(raw)  # before the wait for the turn, because many large requests would stay in memory
                if self._work.must_wait:
                    await self._work.turn()
                self._work.spend_read()
                self._take(self._plans.read(raw))
                await self._outbox.flush()
            while self._calls:
                self._idle.clear()
                await self._idle.wait()
            await self._outbox.finish()
        finally:
            self._under_way.set(0)
            self._held_back.clear()
            self._outbox.close()
            self._rights.close()
            self._store.scheduler.begin(self._cancelling())

    def _take_in_same_turn(self, raw: bytes | memoryview, write: Callable[[bytes], None]) -> bool:
        """Perform a get that does not wait, and write its answer, or its first message. Returns False for other
        requests.
        """
        if self._calls or not self._outbox.is_empty or len(raw) > REQUEST_BYTES_MAX:
            return False
        try:
            call = self._plans.read(bytes(raw))
        except StampedeError:  # the loop that reads the requests raises the same error
            return False
        if call.plan is None or call.plan.wait_nanos or call.plan.group is not None:
            return False
        self._take(call)
        self._outbox.flush_now(write)
        return True

    def _cancelling(self) -> Pieces[None]:
        """Cancel the calls that are left, in pieces. The closed outbox drops the answers that come meanwhile."""
        while self._calls:
            for _ in range(min(GETS_PER_PIECE, len(self._calls))):
                _, get = self._calls.popitem()
                if get is not None:
                    get.cancel()
            yield

    def _take(self, call: GetCall) -> None:
        if call.plan is not None:
            try:
                self._begin(call.call_id, call.plan)
            except StampedeError as error:
                self._refuse(call.call_id, error)
        elif call.refusal is not None:
            self._refuse(call.call_id, call.refusal)
        else:
            self._cancel(call.call_id)
        self._under_way.set(len(self._calls))

    def _begin(self, call_id: int, plan: GetPlan) -> None:
        if call_id in self._calls:
            raise InvalidArgument(f"call {call_id} is under way on this stream; choose another id")
        if len(self._calls) >= CALLS_MAX:
            raise Overloaded(f"{CALLS_MAX} calls are under way on this stream, the limit; open another stream")
        self._account.check(Quota.WAITING_CALLS)
        hosted, now = self._store.find_readable(plan.channel_id, plan.epoch, plan.demand), self._store.now()
        self._rights.check(AccessVerb.READ, AccessKind.CHANNEL, hosted.record.name)
        if plan.group is not None:
            self._begin_in_group(call_id, plan, plan.group, hosted, now)
            return
        get = OpenGet(call_id, plan, hosted, now)
        if get.reads_archive(now):
            self._calls[call_id] = self._stream.spawn(self._read_archive(get))
            return
        if not plan.wait_nanos:
            self._answer_or_wait(get, first_of(hosted.channel.reading(plan.query, now)), now)
            return
        get.pending = hosted.channel.begin(plan.query, now)
        self._answer_or_wait(get, get.poll(now), now)

    def _answer_or_wait(self, get: OpenGet, found: ReadAnswer | WakeAt | UnfinishedWork[Any], now: int) -> None:
        """Send the answer, or let the get wait, or start a task that makes a long answer in pieces."""
        if isinstance(found, UnfinishedWork):
            self._calls[get.call_id] = self._stream.spawn(self._finish(get, found.rest))
        elif isinstance(found, WakeAt):
            assert get.pending is not None, "only a blocking get is to wait"
            self._rights.hold(get.call_id, AccessVerb.READ, AccessKind.CHANNEL, get.hosted.record.name)
            wait_nanos = get.wait_nanos(now)
            self._calls[get.call_id] = get.hosted.gets.add(get.pending, found, wait_nanos, now, self._releaser(get))
        elif get.waits_for_archive:
            self._calls[get.call_id] = self._stream.spawn(self._read_archive(get))
        else:
            self._answer(get, found, now)

    async def _read_archive(self, get: OpenGet) -> None:
        """Answer a get over the archive and memory, or let it wait until memory has the items that it needs."""
        try:
            await self._outbox.room()
            found = await read_recorded(get, self._store.scheduler, self._store.now)
            self._check_served(get, found)
            now = self._store.now()
            self._calls[get.call_id] = None
            if isinstance(found, ReadAnswer):
                self._answer(get, found, now)
            else:
                self._answer_or_wait(get, get.poll(now), now)
        except StampedeError as error:
            self._calls[get.call_id] = None
            self._refuse(get.call_id, error)
        self._outbox.kick()

    async def _finish(self, get: OpenGet, pieces: Pieces[ReadAnswer | WakeAt]) -> None:
        try:
            await self._outbox.room()
            found: ReadAnswer | WakeAt | UnfinishedWork[Any] = await self._store.scheduler.finish(pieces)
            self._check_served(get, found)
            now = self._store.now()
            if isinstance(found, WakeAt) and get.is_outdated:
                found = get.poll(now)
            self._calls[get.call_id] = None
            self._answer_or_wait(get, found, now)
        except StampedeError as error:
            self._calls[get.call_id] = None
            self._refuse(get.call_id, error)
        self._outbox.kick()

    def _check_served(self, get: OpenGet, found: object = None) -> None:
        """Check after a wait that this host still serves the channel, and that the caller may still read it.

        If not, frees the answer `found`, and raises StaleBinding, Unavailable or PermissionDenied.
        """
        try:
            self._store.find_readable(get.plan.channel_id, get.plan.epoch, get.plan.demand)
            self._rights.check(AccessVerb.READ, AccessKind.CHANNEL, get.hosted.record.name)
        except StampedeError:
            self._free(found)
            raise

    def _free(self, found: object) -> None:
        """Free an answer that no caller gets."""
        if isinstance(found, ReadAnswer):
            self._store.scheduler.begin(emptying(found.slices))

    def _begin_in_group(
        self, call_id: int, plan: GetPlan, params: GroupReadParams, hosted: HostedChannel, now: int
    ) -> None:
        check, get = partial(self._rights.check, AccessVerb.READ, AccessKind.GROUP), OpenGet(call_id, plan, hosted, now)
        is_past = plan.as_of is not None and get.reads_archive(now)
        found = None if is_past else self._groups.read_now(params, hosted, plan.query, plan.wait_nanos, now, check)
        if found is None:
            self._rights.hold(call_id, AccessVerb.READ, AccessKind.CHANNEL, hosted.record.name)
            self._calls[call_id] = self._stream.spawn(self._read_in_group(call_id, plan, params, hosted))
        else:
            self._answer(get, found.answer, now, found.cut)

    async def _read_in_group(self, call_id: int, plan: GetPlan, params: GroupReadParams, hosted: HostedChannel) -> None:
        def check(group_name: str) -> None:
            self._rights.check(AccessVerb.READ, AccessKind.GROUP, group_name)
            self._rights.hold(call_id, AccessVerb.READ, AccessKind.GROUP, group_name)

        try:
            began, wait_nanos = self._store.now(), plan.wait_nanos
            found = await self._groups.read(params, hosted, plan.query, wait_nanos, check)
            # No answer may stay in memory while the outbox has no room: drop it, and read again when there is room.
            while not self._outbox.has_room:
                self._free(found.answer)
                del found
                await self._outbox.room()
                self._store.find_readable(plan.channel_id, plan.epoch, plan.demand)
                left_nanos = wait_nanos if wait_nanos < 0 else max(0, began + wait_nanos - self._store.now())
                found = await self._groups.read(params, hosted, plan.query, left_nanos, check)
        except StampedeError as error:
            self._calls[call_id] = None
            self._refuse(call_id, error)
        else:
            now = self._store.now()
            get = OpenGet(call_id, plan, hosted, now)
            get.continues, get.past = found.continues, found.past
            self._answer(get, found.answer, now, found.cut)
        self._outbox.kick()

    def _releaser(self, get: OpenGet) -> Callable[[Outcome], None]:
        def release(outcome: Outcome) -> None:
            self._calls[get.call_id] = None  # the get no longer waits, but its answer is still to be sent
            self._rights.release(get.call_id)
            get.released()
            refusal = refusal_of(get.hosted, get.plan.demand)
            if isinstance(outcome, StampedeError):
                self._refuse(get.call_id, outcome)
            elif refusal is not None:
                self._free(outcome)
                self._refuse(get.call_id, refusal)
            elif self._held_back or not self._outbox.has_room:
                # Drop this outcome, so that no answer stays in memory. `_room_came` starts another poll of the get.
                self._held_back[get.call_id] = get
            else:
                self._answer_or_wait(get, outcome, self._store.now())
            self._outbox.kick()

        return release

    def _room_came(self) -> None:
        if self._held_back and not self._is_polling:
            self._is_polling = True
            self._store.scheduler.begin(self._polling_again())

    def _polling_again(self) -> Pieces[None]:
        """Poll the gets again that were released while the outbox had no room, in the order of their release."""
        try:
            while self._held_back and self._outbox.has_room:
                for call_id in [*islice(self._held_back, POLLS_PER_PIECE)]:
                    self._poll_again(self._held_back.pop(call_id))
                yield
        finally:
            self._is_polling = False

    def _poll_again(self, get: OpenGet) -> None:
        now = self._store.now()
        try:
            self._check_served(get)
            self._answer_or_wait(get, get.poll(now), now)
        except StampedeError as error:
            self._refuse(get.call_id, error)
        self._outbox.kick()

    def _answer(self, get: OpenGet, answer: ReadAnswer, now: int, cut: int | None = None) -> None:
        self._calls[get.call_id] = None
        kept_bytes = kept_bytes_of(answer)
        if not self._account.has_room(Quota.BYTES_IN_FLIGHT, kept_bytes):
            self._free(answer)
            self._refuse(get.call_id, self._account.exceeded(Quota.BYTES_IN_FLIGHT, kept_bytes))
            return
        summary = summary_of(answer, now, cut)
        if get.hosted.copy is not None:
            summary.staleness_nanos = get.hosted.copy.staleness_nanos
        summary.continues = get.continues
        if get.past is not None:
            summary.past.CopyFrom(past_to_message(get.past))
        messages = get_responses(get.call_id, answer, summary, without_payloads=get.plan.without_payloads)
        self._outbox.add(get.call_id, messages, get.hosted.count_delivered, kept_bytes, answer.slices)

    def _refuse(self, call_id: int, error: StampedeError) -> None:
        """Send an error. Does not change `_calls`, because another call with the refused id may be under way."""
        if isinstance(error, Overloaded):
            self._store.refused_calls.note(error)
        self._outbox.add(call_id, get_error(call_id, to_error_message(error)), _count_nothing)

    def _lose(self, call_id: int, error: PermissionDenied) -> None:
        """Refuse a get that waits, because the caller has lost a right."""
        get = self._calls.get(call_id)
        if get is not None:
            self._calls[call_id] = None
            get.cancel()
            self._refuse(call_id, error)
            self._outbox.kick()

    def _cancel(self, call_id: int) -> None:
        self._rights.release(call_id)
        get = self._calls.pop(call_id, None)
        self._held_back.pop(call_id, None)
        if get is not None:
            get.cancel()
        self._outbox.drop(call_id)

    def _ended(self, call_id: int) -> None:
        if self._calls.get(call_id) is None:  # otherwise a later call with this id is under way
            self._calls.pop(call_id, None)
            self._rights.release(call_id)
        self._under_way.set(len(self._calls))
        if not self._calls:
            self._idle.set()


def _count_nothing(items: int, payload_bytes: int) -> None:
    """Does nothing: an error message has no payload bytes to count."""
