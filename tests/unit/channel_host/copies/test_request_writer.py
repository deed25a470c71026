"""The requests of a feed. A feed that ends soon needs no task for them."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt_channel_host.copies.feed_calls import BROKEN_AFTER_SECONDS
from stampede_rt_channel_host.copies.request_writer import RequestWriter
from stampede_rt_runtime.sockets.dialing import HostStream
from tests.support.virtual_time import VirtualClock, run_virtually

PERIOD_S = 0.2


class Call:
    """A stream, over gRPC if `is_socket` is False. Each write takes `write_s`."""

    def __init__(self, write_s: float = 0.0) -> None:
        self._write_s = write_s
        self.sent: list[int] = []
        self.broken_off = 0

    async def write(self, request: pb.FeedRequest) -> None:
        try:
            await asyncio.sleep(self._write_s)
        except asyncio.CancelledError:
            self.broken_off += 1
            raise
        self.sent.append(request.sent_nanos)


class SocketStream(HostStream):
    """A stream over a socket, which takes requests immediately unless it is full."""

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.is_full = False

    @property
    def write_now(self) -> Any:
        return None if self.is_full else lambda request: self.sent.append(request.sent_nanos)

    async def write(self, request: Any) -> None:
        self.sent.append(request.sent_nanos)


class Requests(RequestWriter):
    """A writer whose requests have numbers."""

    def __init__(self) -> None:
        super().__init__(lambda: PERIOD_S, self._check, self._numbered)
        self.made, self.is_silent, self.has_lease = 0, False, True

    def _check(self) -> None:
        if self.is_silent:
            raise TimeoutError

    def _numbered(self) -> pb.FeedRequest:
        if not self.has_lease:
            raise Unavailable("this host has no lease")
        self.made += 1
        self.note_request()
        return pb.FeedRequest(sent_nanos=self.made)


async def _feed(requests: Requests, call: Any, seconds: float) -> None:
    async with asyncio.TaskGroup() as tasks:
        requests.open(call, tasks)
        try:
            await asyncio.sleep(seconds)
        finally:
            requests.stop()
        await requests.aclose()


def test_a_feed_that_ends_within_the_period_has_no_task() -> None:
    async def run(_clock: VirtualClock) -> None:
        requests, call = Requests(), SocketStream()
        before = asyncio.all_tasks()
        async with asyncio.TaskGroup() as tasks:
            requests.open(call, tasks)
            await asyncio.sleep(PERIOD_S / 2)
            requests.write_soon()
            assert asyncio.all_tasks() == before
            requests.stop()
            await requests.aclose()
        assert call.sent == [1]

    run_virtually(run, seed=1)


def test_the_task_writes_a_request_in_each_period() -> None:
    async def run(_clock: VirtualClock) -> None:
        requests, call = Requests(), Call()
        await _feed(requests, call, 3.5 * PERIOD_S)
        assert call.sent == [1, 2, 3]
        await asyncio.sleep(5 * PERIOD_S)
        assert call.sent == [1, 2, 3], "the feed is over"

    run_virtually(run, seed=1)


@pytest.mark.parametrize("state", ["over gRPC", "a full socket", "a request under way"])
def test_the_task_writes_a_request_that_has_to_wait(state: str) -> None:
    async def run(_clock: VirtualClock) -> None:
        requests = Requests()
        call: Any = SocketStream() if state == "a full socket" else Call(PERIOD_S / 4)
        if state == "a full socket":
            call.is_full = True
        async with asyncio.TaskGroup() as tasks:
            requests.open(call, tasks)
            writing = tasks.create_task(requests.write()) if state == "a request under way" else None
            await asyncio.sleep(0)
            requests.write_soon()
            await asyncio.sleep(0.8 * PERIOD_S)
            assert call.sent == ([1] if writing is None else [1, 2])
            requests.stop()
            await requests.aclose()

    run_virtually(run, seed=1)


def test_a_request_due_before_the_stream_opens_is_written_first() -> None:
    async def run(_clock: VirtualClock) -> None:
        requests, call = Requests(), Call()
        requests.wake()
        await _feed(requests, call, PERIOD_S / 2)
        assert call.sent == [1]

    run_virtually(run, seed=1)


def test_the_end_waits_for_a_request_under_way() -> None:
    async def run(_clock: VirtualClock) -> None:
        requests, call = Requests(), Call(PERIOD_S)
        await _feed(requests, call, 1.5 * PERIOD_S)
        assert (call.sent, call.broken_off) == ([1], 0)

    run_virtually(run, seed=1)


@pytest.mark.parametrize("fault", ["a silent source", "a source that takes nothing"])
def test_the_fault_of_a_source_ends_the_feed(fault: str) -> None:
    async def run(_clock: VirtualClock) -> None:
        requests = Requests()
        requests.is_silent = fault == "a silent source"
        call = Call(0.0 if requests.is_silent else 2 * BROKEN_AFTER_SECONDS)
        with pytest.raises(ExceptionGroup) as raised:
            await _feed(requests, call, 3 * BROKEN_AFTER_SECONDS)
        assert isinstance(raised.value.exceptions[0], TimeoutError)
        assert call.sent == []
        requests.write_soon()  # a step of a move may come after the end
        assert call.sent == []

    run_virtually(run, seed=1)


def test_an_error_of_a_request_ends_the_feed_and_not_its_caller() -> None:
    """The caller continues with the other steps of the move."""

    async def write_without_lease(requests: Requests, call: SocketStream) -> None:
        async with asyncio.TaskGroup() as tasks:
            requests.open(call, tasks)
            requests.has_lease = False
            requests.write_soon()
            await asyncio.sleep(PERIOD_S / 2)

    async def run(_clock: VirtualClock) -> None:
        call = SocketStream()
        with pytest.raises(ExceptionGroup) as raised:
            await write_without_lease(Requests(), call)
        assert isinstance(raised.value.exceptions[0], Unavailable)
        assert call.sent == []

    run_virtually(run, seed=1)
