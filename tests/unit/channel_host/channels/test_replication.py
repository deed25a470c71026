"""A channel whose replicas lack its items: the items that it keeps for readers are bounded, and count as its memory."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.errors import Overloaded
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.model import Policy
from stampede_rt.wire.records import policy_to_spec
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.replication import UNSEEN_BYTES_MAX
from stampede_rt_channel_host.cluster.records import recorded_channel
from tests.support.clock import ManualClock

FRAME_BYTES = 2**20


def channel_without_replicas_in_sync(memory: MemoryBudget, clock: ManualClock) -> HostedChannel:
    policy = Policy(max_items=1, replicas=1, ack="replica")
    record = channel_pb2.ChannelRecord(name="cam", epoch=1, incarnation=5, spec=policy_to_spec(policy))
    hosted = HostedChannel(recorded_channel(record), memory, clock.time_unix_nano, lambda _: None)
    assert hosted.replication is not None
    hosted.replication.know([])
    return hosted


def put(hosted: HostedChannel, clock: ManualClock, payload: bytes) -> None:
    clock.advance(1)
    run = IncomingRun(encode_run([payload], times=None, durations=[0]), producer_id=0, first_number=0, wait_nanos=0)
    assert hosted.puts.put(run, clock.time_unix_nano()) is not None


@pytest.mark.asyncio
async def test_items_that_leave_before_the_replicas_have_them_count_as_memory_and_are_bounded() -> None:
    clock, memory = ManualClock(), MemoryBudget(2**40)
    hosted = channel_without_replicas_in_sync(memory, clock)
    frame, accepted = bytes(FRAME_BYTES), UNSEEN_BYTES_MAX // FRAME_BYTES + 1
    for _ in range(accepted):
        put(hosted, clock, frame)
    assert memory.used_bytes >= accepted * FRAME_BYTES
    with pytest.raises(Overloaded, match="before its replicas had them"):
        put(hosted, clock, frame)
    assert hosted.channel.next_seq == 1
    assert hosted.replication is not None
    hosted.replication.configure(Policy(max_items=1, replicas=1, ack="replica", min_replicas=0))
    hosted.replication.accepted(clock.time_unix_nano())
    assert hosted.channel.next_seq == accepted + 1
    put(hosted, clock, frame)
    assert memory.used_bytes < 2 * FRAME_BYTES


@pytest.mark.parametrize(("epoch", "is_known"), [(2, True), (3, False)])
@pytest.mark.asyncio
async def test_an_owner_lists_its_replicas_anew_if_its_epoch_shows_another_owner(epoch: int, is_known: bool) -> None:
    """The other owner may have changed the flags, and may have given replicas items that this host lacks."""
    hosted = channel_without_replicas_in_sync(MemoryBudget(2**40), ManualClock())
    hosted.begin_move().hold()
    hosted.update(replace(hosted.record, epoch=epoch))
    assert hosted.moving is None
    assert hosted.replication is not None
    assert hosted.replication.is_known is is_known
    assert hosted.replication.since_epoch == (1 if is_known else 3)


@pytest.mark.asyncio
async def test_changes_without_items_take_no_memory_while_readers_wait_for_the_replicas() -> None:
    clock = ManualClock()
    hosted = channel_without_replicas_in_sync(MemoryBudget(2**40), clock)
    put(hosted, clock, b"an item")
    assert hosted.replication is not None
    for _ in range(1000):
        clock.advance(1)
        hosted.advance(clock.time_unix_nano())
    assert len(hosted.replication._view._parts) <= 2
    promised = hosted.core.advanced_to
    hosted.replication.configure(Policy(max_items=1, replicas=1, ack="replica", min_replicas=0))
    hosted.replication.accepted(clock.time_unix_nano())
    assert hosted.channel.advanced_to == promised
