"""A channel and the memory of its host: consumption has a bound, too, and never stops where it must free memory."""

from __future__ import annotations

from collections import deque

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.memory import CONSUMPTION_SHARE, MemoryBudget
from stampede_rt_channel_host.channels.puts import IncomingRun
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import CONSUMED_RANGE_BYTES, LEASE_NANOS
from tests.support.clock import ManualClock


def full_channel(items: int) -> tuple[HostedChannel, MemoryBudget, ManualClock]:
    """A channel with one consumer whose items are all that its host may hold."""
    clock, memory = ManualClock(), MemoryBudget(2**40)
    policy = Policy(max_age_nanos=10**12, consumers=1)
    record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(policy))
    channel = HostedChannel(recorded_channel(record), memory, clock.time_unix_nano, lambda _: None)
    for number in range(items // 256):
        run = encode_run([b""] * 256, times=None, durations=[0] * 256)
        ack = channel.puts.put(
            IncomingRun(run, producer_id=0, first_number=1 + 256 * number, wait_nanos=None), clock.time_unix_nano()
        )
        assert ack is not None
    memory.bytes_max = memory.used_bytes
    return channel, memory, clock


def test_seqs_that_are_consumed_out_of_order_are_refused_when_the_spare_memory_is_used_up() -> None:
    channel, memory, _ = full_channel(4096)
    parts = iter([range(first, first + 64, 2) for first in range(2, 4096, 64)])
    with pytest.raises(Overloaded, match="--memory-bytes-max"):
        deque((channel.consume(7, part, LEASE_NANOS) for part in parts), 0)
    spare = memory.bytes_max // CONSUMPTION_SHARE
    assert 0 < memory.used_bytes - memory.bytes_max <= spare
    assert spare - (memory.used_bytes - memory.bytes_max) <= 32 * CONSUMED_RANGE_BYTES, "all of it can be used"


def test_a_consumer_that_consumes_in_order_goes_on_although_the_memory_is_used_up_and_frees_it() -> None:
    channel, memory, clock = full_channel(4096)
    with pytest.raises(Overloaded):
        channel.consume(7, range(2, 4096, 2), LEASE_NANOS)
    channel.consume(7, [], LEASE_NANOS)
    memory.bytes_max = 0
    channel.consume(7, range(1, 4097), LEASE_NANOS)
    channel.collect(clock.time_unix_nano())
    assert channel.channel.counters(clock.time_unix_nano()).held == 0
