"""Runs that a producer puts at the host of its own process: their order, their acks, and the ends of their stream."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from stampede_rt.errors import InvalidArgument, Overloaded, StaleBinding, StampedeError, Unavailable
from stampede_rt.status import from_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.batching import NumberedRun, RunBuilder
from stampede_rt_channel_host.channels import in_process_puts
from stampede_rt_channel_host.channels.in_process_puts import STEP_BYTES_MAX, InProcessPutStream
from stampede_rt_channel_host.core.channel import ReferencedBody


class Puts:
    """The puts of a channel, which accept everything."""

    may_wait = False

    def __init__(self) -> None:
        self.runs: list[Any] = []
        self.announced = 0
        self.refused: dict[int, StampedeError] = {}  # by the number of items of a run

    def announced_together(self) -> Puts:
        return self

    def __enter__(self) -> None:
        return

    def __exit__(self, *_error: object) -> None:
        self.announced += 1

    def put(self, run: Any, now: int) -> pb.PutAck:
        if run.items in self.refused:
            raise self.refused[run.items]
        self.runs.append(run)
        return pb.PutAck(first_number=run.first_number, items=run.items)


class Store:
    """A host with one channel, or with an error instead."""

    recording = replication = None
    record = SimpleNamespace(name="c", policy=SimpleNamespace(ack=None))

    def __init__(self) -> None:
        self.puts = Puts()
        self.error: Exception | None = None

    def now(self) -> int:
        return 5

    def find(self, channel_id: bytes, epoch: int) -> Store:
        assert (channel_id, epoch) == (b"c", 3)
        if self.error is not None:
            raise self.error
        return self


class Stream:
    """A stream of a producer to the store, and the acks and errors that the producer gets."""

    def __init__(self) -> None:
        self.store, self.acks, self.ends = Store(), list[pb.PutAck](), list[StampedeError]()
        self.acked: Callable[[], None] = lambda: None
        loop = asyncio.get_running_loop()
        callbacks = self._on_acks, self.ends.append
        self.puts = InProcessPutStream(loop, cast(Any, self.store), (b"c", 3), (11, 0), *callbacks)

    def _on_acks(self, response: pb.PutResponse) -> None:
        self.acks += response.acks
        self.acked()

    async def steps(self) -> None:
        for _ in range(20):
            await asyncio.sleep(0)


def runs_of(*payloads: list[bytes], time: int | None = None) -> list[NumberedRun]:
    builder, runs = RunBuilder(), []
    for group in payloads:
        for payload in group:
            builder.add((payload, time, None, None, ""), len(payload))
        runs.append(builder.cut())
        builder.drop(runs[-1])
    return runs


async def test_runs_are_put_in_their_order_and_a_lone_payload_stays_the_same_object(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(in_process_puts, "STEP_SECONDS_MAX", 60)  # one step, also on a busy machine
    stream, payload = Stream(), b"p" * 1000
    stream.puts.send(runs_of([payload], [b"a", b"b"], [payload], time=7))
    await stream.steps()
    first, joined, last = stream.store.puts.runs
    assert [(run.first_number, run.items, run.producer_id) for run in (first, joined, last)] == [
        (1, 1, 11), (2, 2, 11), (4, 1, 11),
    ]  # fmt: skip
    assert isinstance(first._encoded, ReferencedBody)
    assert first._encoded.payload is payload
    assert (first.offer.times, [*first.offer.lengths], [*joined.offer.lengths]) == ((7,), [1000], [1, 1])
    assert [ack.first_number for ack in stream.acks] == [1, 2, 4]
    assert stream.store.puts.announced == 1


async def test_runs_that_arrive_while_acks_are_written_are_put_too() -> None:
    stream, later = Stream(), runs_of([b"x"], [b"y"], [b"z"])

    def send_next() -> None:
        if later:
            stream.puts.send([later.pop(0)])

    stream.acked = send_next
    send_next()
    await stream.steps()
    assert [ack.first_number for ack in stream.acks] == [1, 2, 3]


@pytest.mark.parametrize("error", [StaleBinding("moved"), None])
async def test_a_channel_that_is_not_here_any_more_refuses_all_runs_so_that_the_client_opens_a_stream(
    error: StampedeError | None,
) -> None:
    stream = Stream()
    stream.store.error, stream.store.puts.may_wait = error, error is None
    stream.puts.send(runs_of([b"x"], [b"y"]))
    await stream.steps()
    assert [from_error_message(ack.error).reason for ack in stream.acks] == [(error or Unavailable("")).reason] * 2
    assert not stream.store.puts.runs


async def test_a_step_puts_few_bytes_because_the_ring_copies_all_of_them_at_the_end_of_the_step() -> None:
    stream = Stream()
    stream.puts.send(runs_of(*[[bytes(STEP_BYTES_MAX // 2)]] * 6))
    await stream.steps()
    assert [ack.first_number for ack in stream.acks] == [1, 2, 3, 4, 5, 6]
    assert stream.store.puts.announced >= 3


async def test_no_later_run_overtakes_a_run_that_the_producer_sends_again() -> None:
    stream = Stream()
    stream.store.puts.refused[2] = Overloaded("no memory for so much")
    stream.puts.send(runs_of([b"w"], [b"x", b"y"], [b"z"]))
    await stream.steps()
    assert [run.first_number for run in stream.store.puts.runs] == [1]
    assert [(ack.first_number, ack.HasField("error")) for ack in stream.acks] == [(1, False), (2, True), (4, True)]


async def test_no_later_run_overtakes_the_runs_that_came_while_puts_had_to_wait() -> None:
    stream, (first, second) = Stream(), runs_of([b"x"], [b"y"])
    stream.store.puts.may_wait = True
    stream.puts.send([first])
    await stream.steps()
    stream.store.puts.may_wait = False
    stream.puts.send([second])
    await stream.steps()
    assert not stream.store.puts.runs
    assert [ack.HasField("error") for ack in stream.acks] == [True, True]


async def test_a_run_with_a_permanent_error_is_refused_without_the_runs_around_it() -> None:
    stream = Stream()
    stream.store.puts.refused[2] = InvalidArgument("not like this")
    stream.puts.send(runs_of([b"x", b"y"], [b"z"]))
    await stream.steps()
    assert [ack.HasField("error") for ack in stream.acks] == [True, False]


async def test_a_defect_ends_the_stream_once_and_puts_nothing_more() -> None:
    stream = Stream()
    stream.store.error = ValueError("a defect")
    stream.puts.send(runs_of([b"x"]))
    await stream.steps()
    stream.puts.end(Unavailable("the host ends, too"))
    stream.puts.send(runs_of([b"y"]))
    await stream.steps()
    assert ["defect" in str(end) for end in stream.ends] == [True]
    assert not stream.acks


async def test_a_cancelled_stream_puts_no_further_run_and_sends_no_ack() -> None:
    stream = Stream()
    ended: list[bool] = []
    stream.puts.on_over = lambda: ended.append(True)
    stream.puts.send(runs_of([b"x"]))
    stream.puts.cancel()
    stream.puts.cancel()
    await stream.steps()
    assert (stream.acks, stream.ends, stream.store.puts.runs, ended) == ([], [], [], [True])


def test_a_stopped_host_accepts_no_runs() -> None:
    loop = asyncio.new_event_loop()
    loop.close()
    puts = InProcessPutStream(loop, cast(Any, Store()), (b"c", 3), (11, 0), lambda acks: None, lambda error: None)
    with pytest.raises(Unavailable):
        puts.send(runs_of([b"x"]))
