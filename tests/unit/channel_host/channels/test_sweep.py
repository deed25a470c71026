"""The host frees outdated items of channels that no caller uses. It does this work in steps, during the work for
channels in use.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import pytest

from stampede_rt.errors import Overloaded, Unavailable
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels import sweep
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import RECLAIMS_MAX, MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.sweep import Sweep
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from stampede_rt_channel_host.core.deadlines import OUTDATED_PER_CALL_MAX
from stampede_rt_channel_host.core.dedup import KEPT_NANOS
from tests.support.clock import ManualClock

S = 10**9


class Host:
    """Channels under one clock, one budget and one sweep."""

    def __init__(self, bytes_max: int = 2**30) -> None:
        self.clock = ManualClock()
        self.sweep = Sweep(self.clock.time_unix_nano)
        self.memory = MemoryBudget(bytes_max, self.sweep.reclaim)

    def open(self, policy: Policy) -> HostedChannel:
        record = channel_pb2.ChannelRecord(name="a", epoch=1, incarnation=5, spec=policy_to_spec(policy))
        return HostedChannel(recorded_channel(record), self.memory, self.clock.time_unix_nano, self.sweep.touch)

    def put(
        self, channel: HostedChannel, *payloads: bytes, times: Sequence[int] | None = None, producer: int = 0
    ) -> None:
        encoded = encode_run(payloads, times=times, durations=[0] * len(payloads))
        run = IncomingRun(encoded, producer_id=producer, first_number=1, wait_nanos=None)
        ack = channel.puts.put(run, self.clock.time_unix_nano())
        assert ack is not None
        assert not ack.rejections


async def test_a_sweep_collects_items_beyond_the_age_but_keeps_the_newest_one() -> None:
    host = Host()
    channel = host.open(Policy(max_age_nanos=S))
    for _ in range(2000):
        host.put(channel, b"x")
        host.clock.advance(1)
    await host.sweep.sweep()
    assert host.memory.used_bytes == channel.footprint_bytes()
    host.clock.advance(2 * S)
    await host.sweep.sweep()
    assert channel.channel.collect(host.clock.time_unix_nano()) is False  # nothing is left to free
    assert channel.channel.counters(host.clock.time_unix_nano()).collected["age"] == 1999
    assert host.memory.used_bytes == channel.footprint_bytes() == 64 + len(b"x") + _overhead(b"x")


def test_a_put_frees_a_due_item_although_the_deadlines_of_many_channels_have_changed() -> None:
    """A search for deadlines skips a limited number of changed ones in one call."""
    host = Host()
    due, *others = (host.open(Policy(max_age_nanos=S)) for _ in range(3 * OUTDATED_PER_CALL_MAX))
    host.put(due, b"x" * 1000)
    host.clock.advance(1)
    host.put(due, b"x")
    while host.sweep.reclaim():
        pass
    for other in others:
        host.sweep._deadlines.set_due(other, host.clock.time_unix_nano())
        host.sweep._deadlines.set_due(other, host.clock.time_unix_nano() + 100 * S)
    host.clock.advance(2 * S)
    host.memory.bytes_max = host.memory.used_bytes
    host.memory.claim(1000)
    assert due.channel.counters(host.clock.time_unix_nano()).collected["age"] == 1


def _overhead(payload: bytes) -> int:
    """The bytes around a payload in a run of one item: columns, the time and the seq."""
    return len(encode_run([payload], times=[0], durations=[0])) - len(payload) + 9


async def test_a_sweep_does_not_look_at_unchanged_channels() -> None:
    """In an earlier version, 20,000 idle channels took 43 % of a core."""
    host = Host()
    idle = [host.open(Policy(max_age_nanos=S)) for _ in range(2000)]
    for channel in idle:
        host.put(channel, b"x")
    await host.sweep.sweep()
    host.sweep.looked_at = 0
    host.clock.advance(3600 * S)
    await host.sweep.sweep()
    assert host.sweep.looked_at == 0, "the newest item never ages"
    host.put(idle[7], b"y")
    await host.sweep.sweep()
    assert host.sweep.looked_at <= 3


async def test_a_step_of_the_sweep_frees_few_entries_if_many_channels_have_old_items(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    host = Host()
    channels = [host.open(Policy(max_age_nanos=S)) for _ in range(40)]
    for channel in channels:
        for _ in range(100):
            host.put(channel, b"x")
            host.clock.advance(1)
    await host.sweep.sweep()
    freed: list[int] = []

    async def let_others_run() -> None:
        freed.append(sum(one.channel.freed_entries for one in channels))

    monkeypatch.setattr(sweep, "_let_others_run", let_others_run)
    host.clock.advance(2 * S)
    await host.sweep.sweep()
    assert sum(one.channel.freed_entries for one in channels) == 40 * 99
    assert max(after - before for before, after in pairwise(freed)) <= 3 * sweep.ENTRIES_PER_STEP_MAX


async def test_the_memory_of_producers_is_charged_and_freed_without_another_put() -> None:
    host = Host()
    channel = host.open(Policy(max_items=1))
    host.put(channel, b"x")
    without = host.memory.used_bytes
    host.put(channel, b"x", producer=7)
    assert host.memory.used_bytes > without
    await host.sweep.sweep()
    host.clock.advance(KEPT_NANOS)
    await host.sweep.sweep()
    assert host.memory.used_bytes == without


async def test_outdated_items_are_freed_before_a_put_is_refused() -> None:
    host = Host(bytes_max=10_000)
    full, other = host.open(Policy(max_age_nanos=S)), host.open(Policy(max_age_nanos=S))
    host.put(full, b"x" * 9_000)
    host.clock.advance(1)
    host.put(full, b"x")
    host.clock.advance(2 * S)
    host.put(other, b"y" * 5_000)
    assert host.memory.used_bytes < 6_000


async def test_a_dropped_channel_frees_its_memory() -> None:
    host = Host()
    channel = host.open(Policy(max_items=10))
    host.put(channel, b"x")
    run_to_end(channel.leaving(Unavailable("gone")))
    host.sweep.forget(channel)
    assert host.memory.used_bytes == 0
    await host.sweep.sweep()


@pytest.mark.parametrize("max_items", [1, 3])
async def test_the_last_item_of_a_large_run_does_not_keep_the_whole_run_in_memory(max_items: int) -> None:
    """In an earlier version, such an item counted as its length and 64 bytes, but kept 64 kB in memory."""
    host = Host()
    channel = host.open(Policy(max_items=max_items))
    payloads = [b"%03d" % place + bytes(250) for place in range(256)]
    start = host.clock.time_unix_nano()
    host.put(channel, *payloads, times=range(start, start + 256))
    assert channel.footprint_bytes() < 2 * max_items * (253 + 64) + 256
    found, _ = channel.channel.look(start)
    (part,) = found.slices()
    assert part.is_whole
    assert payloads[-max_items] in part.run.body
    assert payloads[0] not in part.run.body


async def test_a_run_without_its_middle_items_is_charged_with_its_kept_bytes() -> None:
    """The rest of a run with gaps stays in its place. It is charged with all the memory that it keeps."""
    host = Host()
    channel = host.open(Policy(max_items=256))
    start = host.clock.time_unix_nano()
    late = [start + 10 * place for place in range(256)]
    host.put(channel, *[bytes(200)] * 256, times=late)
    whole = channel.footprint_bytes()
    host.put(channel, *[bytes(200)] * 200, times=[time + 5 for time in late[56:]])
    assert channel.footprint_bytes() > whole, "both runs have items left"
    assert channel.footprint_bytes() == host.memory.used_bytes


async def test_a_put_of_one_byte_with_large_attributes_is_charged_with_all_kept_bytes() -> None:
    host = Host()
    channel = host.open(Policy(max_items=10))
    encoded = encode_run([b"x"], times=None, attributes={"a": "b" * 10_000})
    run = IncomingRun(encoded, producer_id=0, first_number=1, wait_nanos=None)
    channel.puts.put(run, host.clock.time_unix_nano())
    assert host.memory.used_bytes > 10_000


async def test_a_step_of_the_sweep_looks_at_a_bounded_number_of_changed_channels() -> None:
    host = Host()
    for _ in range(4 * sweep.CHANNELS_PER_STEP_MAX):
        host.sweep.touch(host.open(Policy()))
    counts = [0]
    while host.sweep._step():
        counts.append(host.sweep.looked_at)
    assert [later - earlier for earlier, later in pairwise(counts)] == [sweep.CHANNELS_PER_STEP_MAX] * 4


async def test_a_put_that_needs_memory_looks_at_few_channels_and_at_the_due_ones_first() -> None:
    """In an earlier version, such a put looked at 2048 channels in one step, and began with the channels that had
    changed last.
    """
    host = Host(bytes_max=200_000)
    old = [host.open(Policy(max_age_nanos=S)) for _ in range(4)]
    for channel in old:
        host.put(channel, b"x" * 10_000)
        host.clock.advance(1)
        host.put(channel, b"x")
    await host.sweep.sweep()
    host.clock.advance(2 * S)
    for _ in range(1000):
        host.sweep.touch(host.open(Policy()))
    before, host.sweep.looked_at = host.memory.used_bytes, 0
    host.memory.claim(host.memory.bytes_max - before + 1)
    assert host.memory.used_bytes < before
    assert host.sweep.looked_at <= 2 * sweep.CHANNELS_PER_STEP_MAX
    host.sweep.looked_at = 0
    with pytest.raises(Overloaded):
        host.memory.claim(host.memory.bytes_max)
    assert 0 < host.sweep.looked_at <= 2 * RECLAIMS_MAX * sweep.CHANNELS_PER_STEP_MAX
