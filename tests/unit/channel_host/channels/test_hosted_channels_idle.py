"""A host may hold 100,000 channels, and nearly all of them are idle: each one has to be small."""

from __future__ import annotations

import asyncio
import gc
import os
import subprocess
import sys
import tracemalloc

from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.sweep import Sweep
from stampede_rt_channel_host.channels.time_limits import TimeLimits
from stampede_rt_channel_host.cluster.records import recorded_channel

S = 10**9
CHANNELS = 200
BYTES_MAX = 6 * 1024  # 5,760 with Python 3.11


def idle_channel(number: int, sweep: Sweep, memory: MemoryBudget, limits: TimeLimits) -> HostedChannel:
    record = channel_pb2.ChannelRecord(
        channel_id=os.urandom(16), name=f"robots/{number}", host_id=b"h" * 16, epoch=1, incarnation=number + 2**40,
        spec=policy_to_spec(Policy(max_age_nanos=10 * S)), created_by="robot",
    )  # fmt: skip
    channel = HostedChannel(recorded_channel(record), memory, lambda: S, sweep.touch, limits=limits)
    run = IncomingRun(encode_run([b"x" * 64], times=None), producer_id=0, first_number=0, wait_nanos=None)
    channel.puts.put(run, S)
    return channel


async def used_bytes() -> int:
    """Return the memory of CHANNELS idle channels. An earlier channel has filled the caches that all channels share."""
    sweep, limits = Sweep(lambda: S), TimeLimits()
    memory = MemoryBudget(2**30, sweep.reclaim)
    kept = [idle_channel(0, sweep, memory, limits)]  # fills the caches
    for name in {*HostedChannel.__annotations__} - {*vars(kept[0])}:
        setattr(kept[0], name, getattr(kept[0], name))  # Python keeps one table of names for all channels
    gc.collect()
    tracemalloc.start()
    try:
        kept += [idle_channel(number, sweep, memory, limits) for number in range(1, CHANNELS + 1)]
        await sweep.sweep()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()


def test_an_idle_channel_with_one_item_takes_less_than_six_kilobytes() -> None:
    """This test runs in a separate process, because other tests let constructors of channels fail.

    Then Python keeps one table of names for each channel, and not one for all channels.
    """
    measured = subprocess.run([sys.executable, "-m", __name__], capture_output=True, text=True, check=True, timeout=60)
    assert int(measured.stdout) / CHANNELS < BYTES_MAX


if __name__ == "__main__":
    print(asyncio.run(used_bytes()))
