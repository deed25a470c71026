"""The writes of acks on a stream of puts."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.ack_writer import AckWriter
from tests.support.channel_host.rig import run_of, running_host


async def test_the_reading_loop_acks_a_single_put_and_the_writer_acks_the_requests_of_producers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    writers: list[Any] = []
    acks_by: list[str] = []
    written = asyncio.Semaphore(0)
    run, write = AckWriter._run, AckWriter.write

    async def noted_writer(writer: AckWriter) -> None:
        writers.append(asyncio.current_task())
        await run(writer)

    async def noted_write(writer: AckWriter) -> None:
        has_acks = bool(writer._acks)
        if has_acks:
            acks_by.append("writer" if asyncio.current_task() in writers else "reading loop")
        await write(writer)
        if has_acks:
            written.release()

    monkeypatch.setattr(AckWriter, "_run", noted_writer)
    monkeypatch.setattr(AckWriter, "write", noted_write)
    async with running_host() as rig:
        channel = await rig.open()
        head = {"channel_id": channel.channel_id, "epoch": channel.epoch}
        call: Any = rig.channels.Put()
        for request in (
            pb.PutRequest(**head, puts=[run_of(b"a")]),
            pb.PutRequest(puts=[run_of(b"b")]),
            pb.PutRequest(**head, puts=[run_of(b"c"), run_of(b"d")]),
            pb.PutRequest(**head, puts=[run_of(b"e")]),
        ):
            await call.write(request)
            acks = (await call.read()).acks
            assert len(acks) == len(request.puts)
            await written.acquire()  # gRPC may hand over the ack before the write returns
        await call.done_writing()
    assert acks_by == ["reading loop", "writer", "writer", "reading loop"]
