"""Open channels at a host in this process, and fill them without a client."""

from __future__ import annotations

import random
from collections.abc import Sequence

from stampede_rt.v1 import channel_pb2
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.core.channel import Offer
from tests.benchmarks.longest_pause.sizes import (
    RUN_ITEMS,
)
from tests.support.channel_host.rig import OpenedChannel, Rig, S


async def opened(rig: Rig, **spec: object) -> tuple[OpenedChannel, HostedChannel]:
    retention = channel_pb2.RetentionPolicy(max_age_nanos=36_000 * S, max_bytes=2**40, **spec)  # type: ignore[arg-type]
    channel = await rig.open(f"c{random.getrandbits(60)}", channel_pb2.ChannelSpec(retention=retention))
    return channel, rig.host.store.find(channel.channel_id, channel.epoch)


def fill(hosted: HostedChannel, now: int, times: Sequence[int]) -> None:
    """Store one run, as a put does."""
    run = encode_run([b"x"] * len(times), times=times)
    offer = Offer(times=times, durations=None, lengths=[1] * len(times))
    hosted.channel.put(offer, now, lambda first_seq, kept, stamped: seal_run(run, first_seq))


def in_order(hosted: HostedChannel, rig: Rig, items: int) -> None:
    now = rig.now()
    for at in range(items):
        fill(hosted, now, [now - items + at])


def interleaved(hosted: HostedChannel, rig: Rig, items: int) -> None:
    """Two producers put runs. Each item of one producer lies between two items of the other."""
    now = rig.now()
    for first in range(0, items, 2 * RUN_ITEMS):
        for odd in (0, 1):
            fill(hosted, now, [now - items + first + 2 * at + odd for at in range(RUN_ITEMS)])
