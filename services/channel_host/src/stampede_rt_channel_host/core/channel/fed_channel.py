"""A copy of a channel: a channel that is fed (paper, section 4.1: proxies). Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel.acceptances import Acceptances, AcceptedAdvance, AcceptedRows
from stampede_rt_channel_host.core.channel.base_channel import FREED_ENTRIES_PER_CALL
from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.fed_holdings import FedHoldings
from stampede_rt_channel_host.core.channel.feeding import CollectionFacts, FeedPlace, collection_of
from stampede_rt_channel_host.core.channel.former_incarnations import Losses
from stampede_rt_channel_host.core.channel.held_items import Cut
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.new_item import FedItem
from stampede_rt_channel_host.core.channel.owner_facts import OwnerFacts, OwnerPart
from stampede_rt_channel_host.core.channel.run import Run
from stampede_rt_channel_host.core.dedup import RetryWindow


class FedChannel(ChannelCore):
    """A copy of a channel. Readers use it as any channel. Only its feed changes it: `apply` and `configure`.

    The copy applies no limits itself. Its items leave when the feed says that they have left the source. The caller
    must not call `put`, `advance` and `consume`.
    """

    _held: FedHoldings

    def __init__(
        self, policy: Policy, *, incarnation: int, name: str = "", lost_before: int | None = None,
        cut: Cut | None = None, knows_owner: bool = False, held: FedHoldings | None = None,
    ) -> None:  # fmt: skip
        """Make an empty copy. The other arguments are those of `ChannelCore`.

        `knows_owner`: the copy holds the facts that only the owner knows, and can become the owner. `held`: the items
        with which it begins; None: it has none.
        """
        super().__init__(
            _without_places(policy), incarnation=incarnation, name=name, lost_before=lost_before,
            held=FedHoldings(cut) if held is None else held,
        )  # fmt: skip
        self.owner_facts = OwnerFacts() if knows_owner else None
        self._collection = collection_of(self._held)  # as the source last had it
        self.configure(policy, 0)

    @classmethod
    def of_owner(cls, core: ChannelCore, window: RetryWindow, now: int) -> FedChannel:
        """The copy that a former owner becomes, without copying an item. It can become the owner again.

        From then on the items and the retry window belong to the copy: the caller must not use `core` any more.
        """
        places = core.consumer_places(now)
        held, _ = core.look(now)
        held.report_gone_to(None)
        copy = cls(
            core.policy, incarnation=core.incarnation, name=core.name, lost_before=core.lost_before, knows_owner=True,
            held=FedHoldings.of(held),
        )  # fmt: skip
        copy.owner_facts = OwnerFacts.of_owner(window, core.latest_counters(), places, copy._tick(now))
        copy._acceptance.advance = copy._reading.advance = core.advanced_to
        copy._reading.consumed_up_to = held.newest_consumed
        copy.take_losses(core.losses)
        return copy

    @property
    def place(self) -> FeedPlace:
        """The place from which another feed continues."""
        complete_before = None if self.owner_facts is None else self.owner_facts.complete_before
        return FeedPlace(self._incarnation, self.next_seq, self._held.floor_resets, complete_before)

    @property
    def footprint_bytes(self) -> int:
        """The memory of the items and of the owner's retry window."""
        window = 0 if self.owner_facts is None else self.owner_facts.window.footprint_bytes
        return super().footprint_bytes + window

    def as_owner(self, now: int, incarnation: int | None = None) -> tuple[ChannelCore, RetryWindow]:
        """The channel that this copy becomes, with the retry window. It has the items and runs that this copy has got.

        `incarnation`: the channel's new incarnation, if the owner was lost with later items than this copy has; None:
        the incarnation stays. From then on the items belong to that channel: the caller must not use this copy any
        more.
        """
        facts = self.owner_facts
        assert facts is not None, "the caller has asked the feed for the owner's facts"
        present = self._incarnation if incarnation is None else incarnation
        core = ChannelCore(self._policy, incarnation=present, name=self.name, held=self._held)
        core.acceptances = self.acceptances
        core.take_losses(self.losses if incarnation is None else self._losses_after_owner(now))
        core.inherit(self._tick(now), self.advanced_to, facts.counters, facts.places(now))
        facts.window.keep_up_to(core.next_seq)
        return core, facts.window

    def _losses_after_owner(self, now: int) -> Losses:
        """The losses if the owner is lost. Items come in the order of time, unless some have already come late."""
        newest = None if self._held.late else self._held.newest
        return self.losses.after(self._incarnation, self.next_seq, newest, self._tick(now))

    def apply(
        self, *, first_seq: int, cleared: ItemKey | None, runs: Sequence[Run], next_seq: int,
        collection: CollectionFacts | None, advance: int | None, now: int, owner_part: OwnerPart | None = None,
        accepted: AcceptedRows | None = None, advanced: AcceptedAdvance | None = None,
    ) -> None:  # fmt: skip
        """Apply the next part of the feed (see `FeedPart`). Ignores items that the copy has had before.

        Raises InvalidArgument if the parts before this one are missing.
        """
        self.check_place(first_seq)
        if next_seq < self.next_seq:
            return
        self._tick(now)
        if owner_part is not None and self.owner_facts is not None:
            self.owner_facts.apply(owner_part, now)
        if cleared is not None and first_seq == self.next_seq:
            self._held.clear_below(cleared)
        for run in runs:
            if run.first_seq >= self.next_seq:
                self._held.store_fed(run)
        self._held.skip_to(next_seq)
        self._note_instants(accepted, advanced, now)
        if collection is not None:
            self._collection = collection
            self._held.follow(collection)
            self._reading.consumed_up_to = collection.newest_consumed
            self._held.free(FREED_ENTRIES_PER_CALL)
        if advance is not None:
            self._acceptance.advance = self._reading.advance = advance

    def _note_instants(self, accepted: AcceptedRows | None, advanced: AcceptedAdvance | None, now: int) -> None:
        """Take over the instants of acceptance, but none that is later than the clock of this host."""
        if accepted is None and advanced is None:
            return
        if self.acceptances is None:
            self.acceptances = Acceptances()
        if accepted is not None:
            self.acceptances.take(accepted, now, self._held)
        if advanced is not None:
            self.acceptances.advance = advanced._replace(accepted=min(advanced.accepted, now))

    def check_item(self, fed: FedItem) -> None:
        """Raises InvalidArgument if the copy cannot apply the run, because earlier parts of the feed are missing, or
        facts that a replica needs.
        """
        facts = self.owner_facts
        if facts is not None and not fed.item.producer_id:
            raise InvalidArgument("the feed of a replica has an item without a producer; install the same release")
        if fed.item.seq != self.next_seq or (facts is not None and facts.counters is None):
            raise InvalidArgument(f"the feed has the item with seq {fed.item.seq}, and the copy is at {self.next_seq}")

    def apply_item(self, fed: FedItem, run: Run, now: int) -> None:
        """Apply a part of the feed for which `check_item` raises nothing. `run`: its items."""
        item = fed.item
        moved = None if fed.collected is None else self._collection.with_floor(fed.collected)
        owner_part = None if self.owner_facts is None else self.owner_facts.part_of(item, now)
        self.apply(
            first_seq=item.seq, cleared=None, runs=(run,), next_seq=item.end_seq, collection=moved, advance=None,
            now=now, owner_part=owner_part,
        )  # fmt: skip

    def check_place(self, first_seq: int) -> None:
        """Raises InvalidArgument if the parts of the feed before the seq `first_seq` are missing."""
        if first_seq > self.next_seq:
            raise InvalidArgument(f"the feed continues at seq {first_seq}, and the copy is at seq {self.next_seq}")

    def configure(self, policy: Policy, now: int) -> None:
        """Take over another policy. Items leave only when the feed says so. Raises InvalidArgument."""
        limits = ChannelLimits.of(policy)
        self._policy = policy
        self._retention.limits = limits  # for texts only
        self._held.overlap_nanos = limits.overlap_nanos

    def next_deadline(self, now: int) -> int | None:
        """`now` if memory is left to free; otherwise None: no item leaves because time passes."""
        return self._tick(now) if self._held.has_backlog else None

    def _age(self) -> None:
        """Do nothing: the feed says which items are too old."""

    def _outdate(self, clock: int) -> None:
        """Do nothing: the feed says which items are too old or consumed."""


def _without_places(policy: Policy) -> Policy:
    """The policy without the parts that need consumers, because a copy keeps no consumer places."""
    return replace(policy, consumers=None, max_age_unconsumed_nanos=None, on_full=None)
