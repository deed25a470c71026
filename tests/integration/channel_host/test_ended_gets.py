"""Blocked gets that end with an error, because the host stops serving their channel."""

from __future__ import annotations

import asyncio

from grpc.aio import EOF

from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from tests.support.channel_host.rig import FOREVER, running_host


async def test_a_get_that_ends_with_an_error_is_not_counted_as_waiting() -> None:
    """In an earlier version, the host counted failed gets as open for ever.

    After 1024 of them it refused every get on the stream.
    """
    async with running_host() as rig:
        opened = await rig.open()
        call = rig.channels.Get()
        await call.write(opened.get_request(interval=opened.future(), wait_nanos=FOREVER))
        await opened.until(lambda status: status.waiting_gets == 1)
        await rig.gate.DropChannel(
            gate_pb.DropChannelRequest(request_id=bytes(16), channel_id=opened.channel_id, epoch=opened.epoch)
        )
        assert (await call.read()).HasField("error")
        await call.done_writing()
        async with asyncio.timeout(45):  # the host ends the stream once nothing is under way
            assert await call.read() is EOF
