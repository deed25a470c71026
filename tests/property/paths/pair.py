"""Makes every step on a channel behind a whole path and on the oracle, and checks that the two agree.

`PathPair` has one method for each kind of step. The steps of puts are in `puts.py`, the steps of reads in `reads.py`.
Each method waits until nothing is under way, except calls that wait by the rules of the oracle. So each answer is known
to the nanosecond, although a path may be concurrent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import stampede_rt as st
from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import LEASE_NANOS, ChannelLimits
from tests.property.paths.path_and_oracle import OWN_CONSUMER
from tests.property.paths.puts import PathPuts
from tests.property.paths.values import merge, policy_arguments


class PathPair(PathPuts):
    """One channel behind a path and in the oracle, with its producers, readers and consumers."""

    def tick(self, nanos: int, wall_step: int = 0) -> None:
        """Let time pass, and set the wall clock on or back by `wall_step`.

        The host's clock follows slowly, without a step.
        """
        before, self.clock = self.clock, self.host.tick(nanos, wall_step=wall_step)
        passed = self.clock - before
        assert passed == nanos or (nanos // 2 <= passed <= nanos + nanos // 2 + 1)
        self._changed()

    def advance(self, instant: int) -> None:
        """Advance the channel. The host refuses an instant that is too far in the future."""
        holds = self.oracle.advance(instant, self.clock)
        outcome = self.outcome(lambda: self.channel.advance(instant))
        if not holds:
            assert isinstance(outcome, st.InFuture)
        else:
            assert outcome == self.oracle.advanced_to
            self._changed()

    def configure(self, change: Policy) -> None:
        """Change the policy.

        Fields that `change` leaves out stay. An impossible policy is refused, and changes nothing.
        """
        merged = merge(self.policy, change)
        outcome = self.outcome(lambda: self.channel.configure(**policy_arguments(change)))
        if not _can_hold(merged):
            assert isinstance(outcome, InvalidArgument), outcome
            self.settle()
            return
        assert outcome == merged
        self.policy = merged
        self.oracle.configure(merged, self.clock)
        self._changed()

    def consume(self, consumer_id: int, seqs: Sequence[int], lease: int) -> None:
        """Consume items as a consumer of any id, with a lease of any length."""
        self._consume(consumer_id, seqs, lease, lambda: self.surface.consume(self.channel, consumer_id, seqs, lease))

    def consume_by_client(self, seqs: Sequence[int]) -> None:
        """Consume items by a handle of the client, which keeps a consumer place.

        The lease of the place does not end during a test.
        """
        items = [self.item(self.oracle.log[seq].time, seq) for seq in seqs]
        self._consume(OWN_CONSUMER, seqs, LEASE_NANOS, lambda: self.handles[0].consume(items))

    @property
    def keeps_a_place(self) -> bool:
        """Whether the client keeps a consumer place. The client renews the lease in real time, so tests do not know
        when.
        """
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
        """Delete the channel, and check that all waiting calls end with ChannelNotFound."""
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
