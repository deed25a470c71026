"""A channel behind a whole path and the oracle side by side: every step is made on both, and everything agrees.

The methods are the language in which stories are told, whatever the path: those for reads and subscriptions are in
`path_reads`, those for puts in `path_puts`. After each of them nothing is under way except what has to wait by the
book; so each answer is known to the nanosecond although the path may be a concurrent one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import stampede_rt as st
from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import LEASE_NANOS, ChannelLimits
from tests.property.paths.book import OWN_CONSUMER
from tests.property.paths.puts import PathPuts
from tests.property.paths.values import merge, stated


class PathPair(PathPuts):
    """One channel, twice, and everybody who has to do with it."""

    def tick(self, nanos: int, wall_step: int = 0) -> None:
        """Time passes; the host's clock follows a wall clock that was set by bending, never by stepping."""
        before, self.clock = self.clock, self.host.tick(nanos, wall_step=wall_step)
        passed = self.clock - before
        assert passed == nanos or (nanos // 2 <= passed <= nanos + nanos // 2 + 1)
        self._changed()

    def advance(self, instant: int) -> None:
        """A promise; one too far ahead is refused."""
        holds = self.oracle.advance(instant, self.clock)
        outcome = self.outcome(lambda: self.channel.advance(instant))
        if not holds:
            assert isinstance(outcome, st.InFuture)
        else:
            assert outcome == self.oracle.advanced_to
            self._changed()

    def configure(self, change: Policy) -> None:
        """Other limits while it runs; what is left out stays. Those that cannot hold are refused and change nothing."""
        merged = merge(self.policy, change)
        outcome = self.outcome(lambda: self.channel.configure(**stated(change)))
        if not _can_hold(merged):
            assert isinstance(outcome, InvalidArgument), outcome
            self.settle()
            return
        assert outcome == merged
        self.policy = merged
        self.oracle.configure(merged, self.clock)
        self._changed()

    def consume(self, consumer_id: int, seqs: Sequence[int], lease: int) -> None:
        """By any consumer, for any time."""
        self._consume(consumer_id, seqs, lease, lambda: self.surface.consume(self.channel, consumer_id, seqs, lease))

    def consume_as_participant(self, seqs: Sequence[int]) -> None:
        """By the first participant, whose place the library keeps. As far as a story goes, that lease does not end."""
        items = [self.item(self.oracle.log[seq].time, seq) for seq in seqs]
        self._consume(OWN_CONSUMER, seqs, LEASE_NANOS, lambda: self.handles[0].consume(items))

    @property
    def keeps_a_place(self) -> bool:
        """The library renews a lease, of which only real time knows when."""
        places = self.oracle.consumers
        return places is not None and any(place.consumer_id == OWN_CONSUMER for place in places.taken)

    def _consume(self, consumer_id: int, seqs: Sequence[int], lease: int, call: Callable[[], Any]) -> None:
        outcome = self.outcome(call)
        if self.oracle.consumers is None:
            assert isinstance(outcome, InvalidArgument), outcome
        else:
            items = self.oracle.consume(consumer_id, list(seqs), self.clock, lease)
            if items is None:
                assert isinstance(outcome, st.ChannelFull), outcome
            else:
                assert outcome in (items, (items, lease))
        self._changed()

    def _changed(self) -> None:
        self.announce()
        self.advance_line()
        self.settle()

    def end(self) -> None:
        """The channel is deleted, and whoever waits for it is told."""
        for follower in self.followers:
            follower.followed.subscription.close()
        self.surface.do(self.channel.delete)
        for entry in self.line:
            assert entry.started is not None
            outcome = entry.started.outcome()
            if entry.is_partly_accepted:
                entry.refuse_rest(st.ChannelNotFound.reason)
                assert outcome == entry.ack(self.clock)
            else:
                assert isinstance(outcome, st.ChannelNotFound), outcome
        outcomes = [started.outcome() for *_, started in self.gets]
        assert all(isinstance(one, st.ChannelNotFound) for one in outcomes), outcomes


def _can_hold(policy: Policy) -> bool:
    try:
        ChannelLimits.of(policy)
    except InvalidArgument:
        return False
    return True
