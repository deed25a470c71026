"""A host limits the memory that consumption needs, but it never refuses consumption that frees memory."""

from __future__ import annotations

from collections import deque

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import CONSUMPTION_SHARE, MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel import CONSUMED_RANGE_BYTES, LEASE_NANOS
from tests.support.clock import ManualClock


def full_channel(
    items: int, bytes_max: int = 2**40, consumers: int = 1
) -> tuple[HostedChannel, MemoryBudget, ManualClock]:
    """A channel whose items take all the memory that its host may hold."""
    clock, memory = ManualClock(), MemoryBudget(bytes_max)
    policy = Policy(max_age_nanos=10**12, consumers=consumers)
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
    assert spare - (memory.used_bytes - memory.bytes_max) <= 32 * CONSUMED_RANGE_BYTES, (
        "the consumer can use all of the spare memory"
    )


def test_a_consumer_that_consumes_in_order_is_accepted_although_the_memory_is_used_up() -> None:
    channel, memory, clock = full_channel(4096)
    with pytest.raises(Overloaded):
        channel.consume(7, range(2, 4096, 2), LEASE_NANOS)
    channel.consume(7, [], LEASE_NANOS)
    memory.bytes_max = 0
    channel.consume(7, range(1, 4097), LEASE_NANOS)
    channel.collect(clock.time_unix_nano())
    assert channel.channel.counters(clock.time_unix_nano()).held == 0


def test_the_consumption_of_one_caller_does_not_use_up_the_memory_of_others() -> None:
    """In an earlier version, one caller that consumed every second item could use up the spare memory of the host for
    all channels.
    """
    channel, memory, clock = full_channel(4096, bytes_max=2**22, consumers=2)
    memory.bytes_max = 2**40  # so that the host refuses a caller only for its share
    share = 2**22 // (2 * CONSUMPTION_SHARE)
    parts = iter([range(first, first + 64, 2) for first in range(2, 4096, 64)])
    with pytest.raises(Overloaded, match=f"out-of-order consumption of greedy takes .* of at most {share}"):
        deque((channel.consume(7, part, LEASE_NANOS, "greedy") for part in parts), 0)
    assert 0.8 * share < channel.channel.consumption_bytes_of("greedy") <= share
    channel.consume(7, [1], LEASE_NANOS, "greedy")  # in order, so the host does not refuse it for the share
    channel.consume(8, range(2, 64, 2), LEASE_NANOS, "good")
    clock.advance(LEASE_NANOS + 1)
    channel.collect(clock.time_unix_nano())
    # The first lease of consumer 8 has ended, and keeps no items.
    channel.consume(8, range(2, 128, 2), LEASE_NANOS, "greedy")


def test_memory_for_consumption_counts_for_the_present_owner_of_a_place() -> None:
    channel, memory, clock = full_channel(256, consumers=2)
    memory.bytes_max = 2**40
    channel.consume(7, range(2, 64, 2), LEASE_NANOS, "first")
    taken_bytes = channel.channel.consumption_bytes_of("first")
    channel.consume(7, [], LEASE_NANOS, "second")
    assert channel.channel.consumption_bytes_of("first") == 0
    assert channel.channel.consumption_bytes_of("second") == taken_bytes
    channel.consume(7, [], 0, "second")
    channel.consume(8, [], LEASE_NANOS, "")
    channel.consume(9, [], LEASE_NANOS, "third")
    clock.advance(LEASE_NANOS + 1)
    channel.consume(10, [], LEASE_NANOS, "")
    channel.consume(11, [], LEASE_NANOS, "")
    assert [channel.channel.consumption_bytes_of(one) for one in ("first", "second", "third")] == [0, 0, 0]
