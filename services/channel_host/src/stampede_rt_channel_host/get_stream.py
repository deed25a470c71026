"""One stream of gets: many calls at once, each answered by itself; what can be answered at once costs no task."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.reads import reason_to_message, resolved_to_message
from stampede_rt_channel_host.channels import HostedChannel
from stampede_rt_channel_host.core import Answer, WakeAt
from stampede_rt_channel_host.frames import get_error, get_responses
from stampede_rt_channel_host.outbox import Outbox
from stampede_rt_channel_host.requests import parse, query_of, wait_nanos_of
from stampede_rt_channel_host.store import ChannelStore
from stampede_rt_channel_host.streams import OpenStream
from stampede_rt_channel_host.waiting_gets import Outcome, WaitingGet

CALLS_MAX = 1024


class GetStream:
    """Serves one stream. A call is under way until its last message is written or it is cancelled."""

    def __init__(self, store: ChannelStore, context: Any, stream: OpenStream) -> None:
        self._store = store
        self._context = context
        self._calls: dict[int, WaitingGet | None] = {}  # None: being answered
        self._idle = asyncio.Event()
        self._outbox = Outbox(context, stream, self._ended)

    async def run(self) -> None:
        """Until the caller has closed its side and every call is answered. Raises InvalidArgument for garbage."""
        try:
            while (raw := await self._context.read()) is not EOF:
                self._take(parse(pb.GetRequest, raw, "GetRequest"))
                await self._outbox.flush()
            while self._calls:
                self._idle.clear()
                await self._idle.wait()
            await self._outbox.finish()
        finally:
            self._outbox.close()
            for get in self._calls.values():
                if get is not None:
                    get.cancel()

    def _take(self, request: pb.GetRequest) -> None:
        if request.cancel:
            self._cancel(request.call_id)
            return
        try:
            self._begin(request)
        except StampedeError as error:
            self._refuse(request.call_id, error)

    def _begin(self, request: pb.GetRequest) -> None:
        call_id = request.call_id
        if call_id in self._calls:
            raise InvalidArgument(f"call {call_id} is under way on this stream; choose an id that is not")
        if len(self._calls) >= CALLS_MAX:
            raise Overloaded(f"{CALLS_MAX} calls are under way on this stream, which is the most; open another stream")
        hosted = self._store.find(request.channel_id, request.epoch)
        query, wait_nanos, now = query_of(request), wait_nanos_of(request), self._store.now()
        if not wait_nanos:
            self._answer(request, hosted, hosted.channel.read(query, now), now)
            return
        pending = hosted.channel.begin(query, now)
        found = hosted.channel.poll(pending, now)
        if isinstance(found, WakeAt):
            on_outcome = self._releaser(request, hosted)
            self._calls[call_id] = hosted.gets.add(pending, found, wait_nanos, now, on_outcome)
        else:
            self._answer(request, hosted, found, now)

    def _releaser(self, request: pb.GetRequest, hosted: HostedChannel) -> Callable[[Outcome], None]:
        def release(outcome: Outcome) -> None:
            if isinstance(outcome, StampedeError):
                self._refuse(request.call_id, outcome)
            else:
                self._answer(request, hosted, outcome, self._store.now())
            self._outbox.kick()

        return release

    def _answer(self, request: pb.GetRequest, hosted: HostedChannel, answer: Answer, now: int) -> None:
        self._calls[request.call_id] = None
        messages = get_responses(
            request.call_id, answer, summary_of(answer, now), without_payloads=request.without_payloads
        )
        self._outbox.add(request.call_id, messages, hosted.count_delivered)

    def _refuse(self, call_id: int, error: StampedeError) -> None:
        """Not entered among the calls: a refused id may be one that is under way."""
        self._outbox.add(call_id, get_error(call_id, to_error_message(error)), _count_nothing)

    def _cancel(self, call_id: int) -> None:
        get = self._calls.pop(call_id, None)
        if get is not None:
            get.cancel()
        self._outbox.drop(call_id)

    def _ended(self, call_id: int) -> None:
        if self._calls.get(call_id) is None:  # else the id was used again by a call that waits
            self._calls.pop(call_id, None)
        if not self._calls:
            self._idle.set()


def summary_of(answer: Answer, now: int) -> pb.GetSummary:
    """What the reader is to know beside the items."""
    return pb.GetSummary(
        interval=resolved_to_message(answer.interval) if answer.interval else None,
        complete=answer.complete,
        truncated=answer.truncated,
        more=answer.more,
        reason=reason_to_message(answer.reason),
        detail=answer.reason.detail if answer.reason else "",
        incarnation=answer.incarnation,
        host_time_unix_nano=now,
    )


def _count_nothing(payload_bytes: int) -> None:
    """An error carries no payload."""
