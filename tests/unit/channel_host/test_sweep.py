"""What retention has outdated is freed although nobody asks for it."""

from __future__ import annotations

from stampede_rt.model import Policy
from stampede_rt.v1 import channel_pb2
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts import IncomingRun
from stampede_rt_channel_host.channels.sweep import sweep
from tests.unit.channel_host.manual_clock import ManualClock

S = 10**9


def hosted(clock: ManualClock, policy: Policy) -> HostedChannel:
    record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(policy))
    return HostedChannel(record, MemoryBudget(2**30, lambda: 0, clock.boottime_nanos), clock.time_unix_nano)


def put(channel: HostedChannel, clock: ManualClock, payload: bytes) -> None:
    encoded = encode_run([payload], times=None, durations=[0])
    channel.puts.put(IncomingRun(encoded, producer_id=0, first_number=1, wait_nanos=None), clock.time_unix_nano())


async def test_a_channel_is_swept_when_its_items_are_of_age_and_keeps_the_newest() -> None:
    clock = ManualClock()
    channel = hosted(clock, Policy(max_age_nanos=S))
    for _ in range(2000):
        put(channel, clock, b"x")
        clock.advance(1)
    deadline = channel.channel.next_deadline(clock.time_unix_nano())
    assert deadline is not None
    clock.advance(2 * S)
    await sweep([channel], clock.time_unix_nano)
    assert channel.channel.collect(clock.time_unix_nano()) is False  # nothing is left to free
    assert channel.channel.counters(clock.time_unix_nano()).collected["age"] == 1999
    assert channel.footprint_bytes() == 65


async def test_a_channel_without_an_age_is_left_alone() -> None:
    clock = ManualClock()
    channel = hosted(clock, Policy(max_items=10))
    put(channel, clock, b"x")
    clock.advance(3600 * S)
    await sweep([channel], clock.time_unix_nano)
    assert channel.footprint_bytes() == 65
