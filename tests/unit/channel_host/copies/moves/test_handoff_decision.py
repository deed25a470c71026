"""The last step of the former owner in a move: it hands the channel over only when the copy has everything."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from stampede_rt.values.model import Policy
from stampede_rt.wire.runs import encode_run
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.puts.incoming_run import IncomingRun
from stampede_rt_channel_host.channels.puts.puts import ChannelPuts
from stampede_rt_channel_host.copies.moves.handoff_decision import IDLE_NANOS, HandoffDecision
from stampede_rt_channel_host.core.channel import ChannelCore, ChannelFeed

MOST_BYTES = 2**20


class Source:
    """A channel with room for two items, and the feed of a move away from it."""

    def __init__(self) -> None:
        self.now = 1000
        self.channel = ChannelCore(Policy(max_items=2, on_full="block", consumers=1), incarnation=7)
        self.puts = ChannelPuts(
            self.channel, MemoryBudget(MOST_BYTES), lambda: self.now, lambda now: None, lambda: None
        )
        self.feed = ChannelFeed(self.channel, None, self.now, self.puts.retries)
        self.move: Any = SimpleNamespace(is_held=False, permit=b"permit", hold=self._hold)
        hosted: Any = SimpleNamespace(puts=self.puts, replication=None)
        self.handoff_decision = HandoffDecision(hosted, self.move, self.feed, when_idle=True)

    def _hold(self) -> None:
        self.puts.hold()
        self.move.is_held = True

    def put(self, items: int) -> None:
        run = IncomingRun(
            encode_run([b"x"] * items, times=[self.now] * items), producer_id=7, first_number=1, wait_nanos=None
        )
        run.keep()
        self.puts.put(run, self.now)


def test_an_idle_channel_is_held_and_handed_over_immediately() -> None:
    source = Source()
    source.put(2)
    source.now += IDLE_NANOS
    source.feed.take(source.now, MOST_BYTES)
    assert source.handoff_decision.next_handoff(source.now) is not None
    assert source.handoff_decision.next_handoff(source.now) is None, "the channel is handed over a second time"


def test_the_copy_gets_the_outcomes_of_waiting_runs_before_the_channel_is_handed_over() -> None:
    """In an earlier version, the next owner did not know a run that waited for room, and accepted its items twice."""
    source = Source()
    source.put(3)
    source.now += IDLE_NANOS
    source.feed.take(source.now, MOST_BYTES)
    assert source.handoff_decision.next_handoff(source.now) is None
    part = source.feed.take(source.now, MOST_BYTES)
    assert part is not None
    assert part.owner_part is not None
    assert [run.outcome.judged_items for run in part.owner_part.runs] == [2]
    assert source.handoff_decision.next_handoff(source.now) is not None
