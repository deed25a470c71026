"""A copy of a channel: a channel that is fed (paper, section 4.1: proxies). Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.fed_holdings import FedHoldings
from stampede_rt_channel_host.core.channel.feeding import Collection, FeedPlace
from stampede_rt_channel_host.core.channel.held_items import Cut
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.run import Run


class FedChannel(ChannelCore):
    """A copy of a channel. It is read as any channel. Only its feed changes it: `apply` and `configure`.

    The copy applies no limits itself. Its items leave when the feed says that they have left the source. The caller
    must not call `put`, `advance` and `consume`.
    """

    _held: FedHoldings

    def __init__(
        self, policy: Policy, *, incarnation: int, name: str = "", lost_before: int | None = None,
        cut: Cut | None = None,
    ) -> None:  # fmt: skip
        """As `ChannelCore`."""
        super().__init__(_without_places(policy), incarnation=incarnation, name=name, lost_before=lost_before, cut=cut)
        self.configure(policy, 0)

    @staticmethod
    def _empty_holdings(cut: Cut | None) -> Holdings:
        return FedHoldings(cut)

    @property
    def place(self) -> FeedPlace:
        """The place from which another feed continues."""
        return FeedPlace(self._incarnation, self.next_seq, self._held.floor_resets)

    def apply(
        self, *, first_seq: int, cleared: ItemKey | None, runs: Sequence[Run], next_seq: int,
        collection: Collection | None, advance: int | None, now: int,
    ) -> None:  # fmt: skip
        """Apply the next part of the feed (see `FeedPart`). Ignores items that the copy has had before.

        Raises InvalidArgument if the parts before this one are missing.
        """
        if first_seq > self.next_seq:
            raise InvalidArgument(f"the feed continues at seq {first_seq}, and the copy is at seq {self.next_seq}")
        if next_seq < self.next_seq:
            return
        self._tick(now)
        if cleared is not None and first_seq == self.next_seq:
            self._held.clear_below(cleared)
        for run in runs:
            if run.first_seq >= self.next_seq:
                self._held.store_fed(run)
        self._held.skip_to(next_seq)
        if collection is not None:
            self._held.follow(collection)
            self._reading.consumed_up_to = collection.newest_consumed
        if advance is not None:
            self._acceptance.advance = self._reading.advance = advance

    def configure(self, policy: Policy, now: int) -> None:
        """Take over another policy. Items leave only when the feed says so. Raises InvalidArgument."""
        limits = ChannelLimits.of(policy)
        self._policy = policy
        self._retention.limits = limits  # for texts only
        self._held.overlap_nanos = limits.overlap_nanos

    def next_deadline(self, now: int) -> int | None:
        """`now` if memory is left to free, else None: no item leaves because time passes."""
        return self._tick(now) if self._held.has_backlog else None

    def _age(self) -> None:
        """Nothing: the feed says which items are too old."""

    def _outdate(self, clock: int) -> None:
        """Nothing: the feed says which items are too old or consumed."""


def _without_places(policy: Policy) -> Policy:
    """The policy without the parts that need consumers, because a copy keeps no consumer places."""
    return replace(policy, consumers=None, max_age_unconsumed_nanos=None, on_full=None)
