"""Few streams continue in each turn of the event loop, however many have been read or written."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
import pytest

from stampede_rt_runtime import pacing
from stampede_rt_runtime.pacing import STREAMS_PER_TURN, PacedContext, PacingInterceptor, SameTurnBudget, TurnGate
from stampede_rt_runtime.quotas import loop_shares
from stampede_rt_runtime.quotas.accounts import Account
from stampede_rt_runtime.quotas.limits import DEFAULTS
from stampede_rt_runtime.quotas.working import CallerWork

STREAMS = 200
ONE, OTHER = Account("one", DEFAULTS), Account("other", DEFAULTS)


class TurnCounter:
    """Counts the turns of the event loop, and the streams that continue in each."""

    def __init__(self) -> None:
        self.number = 0
        self.went_on: Counter[int] = Counter()
        self._counting = asyncio.get_running_loop().call_soon(self._count)

    def _count(self) -> None:
        self.number += 1
        self._counting = asyncio.get_running_loop().call_soon(self._count)

    def note(self) -> None:
        self.went_on[self.number] += 1

    async def until(self, condition: Callable[[], bool]) -> None:
        while not condition():  # noqa: ASYNC110  (there is no event for it)
            await asyncio.sleep(0)
        self._counting.cancel()


async def test_a_few_callers_continue_in_each_turn_in_the_order_of_arrival() -> None:
    gate, turns, order = TurnGate(), TurnCounter(), list[int]()

    async def pass_through(number: int) -> None:
        if not gate.try_admit(ONE):
            await gate.turn(ONE)
        turns.note()
        order.append(number)

    async with asyncio.TaskGroup() as group:
        for number in range(STREAMS):
            group.create_task(pass_through(number))
        await turns.until(lambda: len(order) == STREAMS)
    assert order == [*range(STREAMS)]
    assert max(turns.went_on.values()) <= 2 * STREAMS_PER_TURN
    assert len(turns.went_on) >= STREAMS / STREAMS_PER_TURN - 1


async def test_many_waiting_streams_of_one_caller_do_not_delay_a_stream_of_another_one() -> None:
    gate, turns = TurnGate(), TurnCounter()
    crowd = [asyncio.ensure_future(gate.turn(ONE)) for _ in range(STREAMS) if not gate.try_admit(ONE)]
    assert len(crowd) == STREAMS - STREAMS_PER_TURN
    for _ in range(3):  # one request after the other
        began = turns.number
        if not gate.try_admit(OTHER):
            await gate.turn(OTHER)
        assert turns.number - began <= 2
        await asyncio.sleep(0)
    assert sum(one.done() for one in crowd) < STREAMS / 2
    await turns.until(lambda: all(one.done() for one in crowd))


async def test_a_single_caller_does_not_wait() -> None:
    gate = TurnGate()
    for _ in range(3):
        assert gate.try_admit(ONE)
        await asyncio.sleep(0)


async def test_a_cancelled_caller_uses_up_no_turn() -> None:
    gate = TurnGate()

    async def enter() -> None:
        if not gate.try_admit(ONE):
            await gate.turn(ONE)

    callers = [asyncio.create_task(enter()) for _ in range(20 * STREAMS_PER_TURN)]
    await asyncio.sleep(0)
    for caller in callers[STREAMS_PER_TURN : 19 * STREAMS_PER_TURN]:
        caller.cancel()
    for _ in range(5):
        await asyncio.sleep(0)
    assert all(caller.done() for caller in callers)
    assert gate.try_admit(ONE)


class Stream:
    """A context whose reads and writes are done immediately."""

    def __init__(self) -> None:
        self.written: list[bytes] = []

    async def read(self) -> bytes:
        await asyncio.sleep(0)
        return b"request"

    async def write(self, message: bytes) -> None:
        await asyncio.sleep(0)
        self.written.append(message)

    def peer(self) -> str:
        return "ipv4:1.2.3.4:5"


async def test_a_long_message_that_was_read_counts_for_its_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    spent: list[object] = []
    monkeypatch.setattr(CallerWork, "received", lambda work, message: spent.append(message))
    context = PacedContext(Stream(), TurnGate(), TurnGate(), ONE)  # type: ignore[arg-type]
    assert await context.read() == b"request"
    assert spent == [b"request"]


@pytest.mark.parametrize("operation", ["read", "write"])
async def test_streams_whose_messages_need_no_wait_continue_a_few_in_each_turn(operation: str) -> None:
    turns, reads, writes, done = TurnCounter(), TurnGate(), TurnGate(), list[Any]()

    async def serve() -> None:
        context = PacedContext(Stream(), reads, writes)  # type: ignore[arg-type]
        done.append(await (context.read() if operation == "read" else context.write(b"m")))
        turns.note()

    async with asyncio.TaskGroup() as group:
        for _ in range(STREAMS):
            group.create_task(serve())
        await turns.until(lambda: len(done) == STREAMS)
    assert max(turns.went_on.values()) <= 2 * STREAMS_PER_TURN
    assert {*done} == {b"request" if operation == "read" else None}


def test_the_other_methods_of_a_context_are_unchanged() -> None:
    assert PacedContext(Stream(), TurnGate(), TurnGate()).peer() == "ipv4:1.2.3.4:5"  # type: ignore[arg-type]


async def _handler(behavior: Any) -> Any:
    async def found(_: Any) -> Any:
        return grpc.stream_stream_rpc_method_handler(behavior)

    return (await PacingInterceptor().intercept_service(found, None)).stream_stream  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["unary", "stream", "responses"])
async def test_every_kind_of_call_is_charged_the_cost_of_its_work(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """This holds for every service: for example, a supernode's list with a pattern costs more than a list without."""
    now = 10**9
    monkeypatch.setattr("time.thread_time_ns", lambda: now)
    caller = Account("one", DEFAULTS, loop_shares=loop_shares.LoopShares(lambda: now, lambda delay_s, call: None))
    monkeypatch.setattr(pacing, "current_account", lambda: caller)
    monkeypatch.setattr(pacing, "current_work", lambda: CallerWork(caller))

    def work() -> None:
        nonlocal now
        now += 3 * 10**8

    async def call(_request: Any, _context: Any) -> None:
        work()

    async def responses(_request: Any, _context: Any) -> AsyncIterator[bytes]:
        work()
        yield b"one"

    if kind == "unary":

        async def found(_: Any) -> Any:
            return grpc.unary_unary_rpc_method_handler(call)

        handler = (await PacingInterceptor().intercept_service(found, None)).unary_unary  # type: ignore[arg-type]
    else:
        handler = await _handler(call if kind == "stream" else responses)
    await handler(None, Stream())
    now += 10**9
    assert caller.loop_share is not None
    assert caller.loop_share.used_percent() == 30


async def test_responses_that_are_yielded_wait_for_the_turn_of_their_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    caller = Account("one", DEFAULTS, loop_shares=loop_shares.LoopShares(lambda: 10**9, lambda delay_s, call: None))
    waiting = CallerWork(caller)
    monkeypatch.setattr(pacing, "current_work", lambda: waiting)
    assert caller.loop_share is not None
    caller.loop_share.enqueue(lambda: None)  # a step of another stream

    async def responses(_request: Any, _context: Any) -> AsyncIterator[bytes]:
        yield b"one"

    stream = Stream()
    call = asyncio.create_task((await _handler(responses))(None, stream))
    for _ in range(5):
        await asyncio.sleep(0)
    assert stream.written == []
    call.cancel()
    await asyncio.wait({call})


async def test_a_stream_that_is_cancelled_again_while_it_waits_to_end_also_ends() -> None:
    """In an earlier version, if a caller left at the moment of its revocation, the stream went on without a caller and
    without a quota.
    """
    ended = 0

    async def behavior(_requests: Any, _context: Any) -> None:
        nonlocal ended
        try:
            await asyncio.Event().wait()
        finally:
            ended += 1

    handler = await _handler(behavior)
    calls = [asyncio.create_task(handler(None, Stream())) for _ in range(STREAMS)]
    for _ in range(3):
        await asyncio.sleep(0)
    for _ in range(2):
        for call in calls:
            call.cancel()
        await asyncio.sleep(0)
    await asyncio.gather(*calls, return_exceptions=True)
    assert ended == STREAMS


async def test_streams_whose_callers_disconnect_together_end_a_few_in_each_turn() -> None:
    ended = 0

    async def behavior(_requests: Any, _context: Any) -> None:
        nonlocal ended
        try:
            await asyncio.Event().wait()
        finally:
            ended += 1
            turns.note()

    handler = await _handler(behavior)
    calls = [asyncio.create_task(handler(None, Stream())) for _ in range(STREAMS)]
    for _ in range(3):
        await asyncio.sleep(0)
    turns = TurnCounter()
    for call in calls:
        call.cancel()
    await turns.until(lambda: ended == STREAMS)
    assert max(turns.went_on.values()) <= 2 * STREAMS_PER_TURN
    await asyncio.wait(calls)
    assert all(call.cancelled() for call in calls)


async def test_an_error_of_a_stream_reaches_its_caller() -> None:
    async def behavior(_requests: Any, _context: Any) -> None:
        raise KeyError("no")

    handler = await _handler(behavior)
    with pytest.raises(KeyError):
        await handler(None, Stream())


async def test_streams_that_yield_their_responses_continue_and_end_a_few_in_each_turn() -> None:
    ended = 0

    async def behavior(_requests: Any, _context: Any) -> AsyncIterator[bytes]:
        nonlocal ended
        try:
            yield b"one"
            turns.note()
            yield b"two"
            await asyncio.Event().wait()
        finally:
            ended += 1
            turns.note()

    handler, streams, turns = await _handler(behavior), [Stream() for _ in range(STREAMS)], TurnCounter()
    calls = [asyncio.create_task(handler(None, stream)) for stream in streams]
    while not all(stream.written == [b"one", b"two"] for stream in streams):  # noqa: ASYNC110  (no event)
        await asyncio.sleep(0)
    for call in calls:
        call.cancel()
    await turns.until(lambda: ended == STREAMS)
    assert turns.went_on.total() == 2 * STREAMS
    assert max(turns.went_on.values()) <= 2 * STREAMS_PER_TURN
    await asyncio.wait(calls)


async def test_messages_are_answered_immediately_for_a_bounded_time_in_each_turn() -> None:
    now, turns, step = 0, TurnCounter(), pacing.SAME_TURN_NANOS // 4
    budget = SameTurnBudget(lambda: now)

    def answer() -> None:
        nonlocal now
        if budget.is_left():
            now += step
            budget.spend(step)
            turns.note()

    for _ in range(3):
        for _ in range(100):
            answer()
        await asyncio.sleep(0)
        await asyncio.sleep(0)
    await turns.until(lambda: True)
    assert sorted(turns.went_on.values()) == [4, 4, 4]


async def test_a_loop_with_pauses_answers_every_message_immediately() -> None:
    now = 0
    budget = SameTurnBudget(lambda: now)
    for _ in range(100):
        assert budget.is_left()
        now += pacing.SAME_TURN_NANOS // 2  # the answer
        budget.spend(pacing.SAME_TURN_NANOS // 2)
        now += pacing.SAME_TURN_NANOS // 2  # the pause


async def test_a_caller_beyond_its_share_is_not_answered_immediately_and_answers_count_for_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Socket:
        def answer_in_same_turn(self, take: Callable[..., bool]) -> None:
            self.take = take

    spent: list[int] = []
    monkeypatch.setattr(CallerWork, "spend", lambda _work, nanos: spent.append(nanos))
    socket: Any = Socket()
    PacedContext(socket, TurnGate(), TurnGate(), ONE, SameTurnBudget()).answer_in_same_turn(lambda message, write: True)
    assert socket.take(b"x", print)
    assert len(spent) == 1
    monkeypatch.setattr(CallerWork, "must_wait", property(lambda _work: True))
    assert not socket.take(b"x", print)
    assert len(spent) == 1
