"""The feed of a channel: the facts from which a copy of the channel is made (paper, section 4.1: proxies). Pure.

The source of a feed is the channel's owner, or another copy. It keeps no queue for a copy. As for a subscription, it
keeps the copy's place in the order of seqs, and takes the next items from the channel. Each part of the feed has the
items from that place on, and the source's present state. After each part the copy therefore holds exactly those items
of the source that lie before the copy's place. The copy lacks the items that left the source before the copy received
them.
"""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.errors import Overloaded, Unavailable
from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.core.channel.acceptances import AcceptedAdvance, AcceptedRows
from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.new_item import FedItem, NewFloor, NewItem, new_item
from stampede_rt_channel_host.core.channel.owner_facts import OwnerFactsFeed, OwnerPart
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.subscribing import AllCursor
from stampede_rt_channel_host.core.dedup import RetryWindow


class FeedPlace(NamedTuple):
    """The place of a copy: it holds the state of the source up to the seq `next_seq`, exclusive.

    `floor_resets`: how often the source had set its floor back (see `HeldItems.floor_resets`). `owner_until`: the copy
    has all runs of the owner's retry window before this time of the owner's clock; None: it has none.
    """

    incarnation: int
    next_seq: int
    floor_resets: int
    owner_until: int | None = None


class CollectionFacts(NamedTuple):
    """The items that retention has collected from a channel (see the attributes of `HeldItems`).

    All items below the key `floor` are collected. `frontier_max` bounds the frontier while the channel holds no item.
    """

    floor: ItemKey
    floor_resets: int
    last_cause: str
    newest_collected: int | None
    collected_end: int | None
    collected_by: str
    newest_consumed: int | None
    frontier_max: int | None

    def with_floor(self, new: NewFloor) -> CollectionFacts:
        """This collection with the fields of `new`."""
        return self._replace(floor=new.floor, newest_collected=new.newest_collected, collected_end=new.collected_end)


class FeedPart(NamedTuple):
    """The next part of a feed. The copy applies the fields in their order.

    `first_seq`: the copy's place before this part. `cleared`: the copy drops the items below this key that it held
    before this part, because the source has set its floor back since the previous part; None: the floor was not set
    back. `slices`: the next items, in the order of seqs. `next_seq`: the copy's place after this part. Seqs before
    it that the copy has not got are missing: the source no longer holds their items. `collection` and `advance` are
    None if they have not changed since the previous part. `owner_part`: the facts that only the owner knows, if the
    copy has asked for them. `accepted` and `advanced`: when the owner of a recorded channel accepted the items, and the
    advance; None: the copy has not asked for the owner's facts, or the instants are not known.
    """

    first_seq: int
    cleared: ItemKey | None
    slices: tuple[Slice, ...]
    next_seq: int
    collection: CollectionFacts | None
    advance: int | None
    owner_part: OwnerPart | None = None
    accepted: AcceptedRows | None = None
    advanced: AcceptedAdvance | None = None

    def can_join(self, former: FeedPart) -> bool:
        """Whether one part can replace both parts: this part has no items, and clears no items of `former`."""
        return (
            self.next_seq == former.next_seq and (self.cleared is None or not former.slices) and self.owner_part is None
        )

    def joined_to(self, former: FeedPart) -> FeedPart:
        """`former` with the state of this part."""
        cleared = [one for one in (former.cleared, self.cleared) if one is not None]
        return former._replace(
            cleared=max(cleared, default=None),
            collection=former.collection if self.collection is None else self.collection,
            advance=former.advance if self.advance is None else self.advance,
            advanced=former.advanced if self.advanced is None else self.advanced,
        )


CATCH_UP_NANOS = 10_000_000_000
"""A copy stays behind if its lag has not shrunk within this time."""


class LagWatch:
    """Notices that a copy stays behind its source. `now` in nanoseconds, of a clock that never goes back."""

    def __init__(self) -> None:
        self._began: tuple[int, int] | None = None  # when the copy was last seen to be behind, and by how many items

    def stays_behind(self, items: int, now: int) -> bool:
        """Whether the lag of the copy, `items` at `now`, has not shrunk for CATCH_UP_NANOS."""
        if not items or self._began is None:
            self._began = (now, items) if items else None
            return False
        since, before = self._began
        if now - since < CATCH_UP_NANOS:
            return False
        self._began = now, items
        return items >= before

    def check(self, channel: str, items: int, now: int) -> None:
        """Raises Overloaded if the copy of the channel stays behind."""
        if self.stays_behind(items, now):
            raise Overloaded(
                f"the copy of channel {channel} cannot catch up: it is {items} items behind, and was no further "
                f"behind {CATCH_UP_NANOS // 10**9} s ago; put less, or give it a faster link (--copy-bytes-per-second)",
                metadata={"channel": channel},
            )


class ChannelFeed:
    """The source's side of one feed. Call `close` at its end."""

    def __init__(
        self, source: ChannelCore, place: FeedPlace | None, now: int, window: RetryWindow | None = None, *,
        is_exact: bool = False, follows: bool = False, takes_puts: bool = False,
    ) -> None:  # fmt: skip
        """Begin a feed at `place`. None: the copy holds nothing, and the feed begins with the oldest item.

        With `window`, the retry window of the channel's owner, the feed has the facts that only the owner knows, too.
        `is_exact`: a part names the items that have left only if it completes the items of the copy.
        The copy therefore gets new items before it drops the items that left the source because of them. `follows`: the
        source is itself a copy of the owner from which `place` comes. `takes_puts`: see `OwnerFactsFeed`.

        If the source cannot continue at `place`, because the incarnation or the floor differs, `begins_anew` is True.
        The copy then drops its items, and the feed begins with the oldest item. With `follows`, raises Unavailable
        if the source is behind `place`, because it soon reaches `place`. Without `follows`, a source that is behind
        `place` never reaches it, because it took the channel over without the last items of the former owner.
        """
        held, _ = source.look(now)
        self.begins_anew = not _continues(source, held, place, follows=follows)
        first_seq = 1 if self.begins_anew or place is None else place.next_seq
        self._source = source
        self._is_exact = is_exact
        self._cursor = AllCursor(iter(()), first_seq)
        self._cleared: ItemKey | None = None
        self._sent: tuple[CollectionFacts | None, int | None] = None, None
        held.report_resets_to(self._note_reset)
        since = None if self.begins_anew or place is None else place.owner_until
        self.owner_facts = None if window is None else OwnerFactsFeed(source, window, since, takes_puts=takes_puts)

    @property
    def next_seq(self) -> int:
        """The copy's place, as far as the source has fed it."""
        return self._cursor.next_seq

    @property
    def source_next_seq(self) -> int:
        """The place of a copy that has all items of the source."""
        return self._source.next_seq

    @property
    def waiting_items(self) -> int:
        """The number of items of the source that the copy has not got, computed from seqs. It may be too high."""
        return given_between(self.next_seq, self._source.next_seq)

    def take(self, now: int, limit_bytes: int) -> FeedPart | None:
        """The next part of about `limit_bytes` at most, or None if nothing has changed. Moves the place.

        With a limit of 0 the part has no items. The sizes are counted as in `ChannelCore.since`.
        """
        before = self.next_seq
        owner_part = None if self.owner_facts is None else self.owner_facts.take(now)
        # The copy must know the runs of the items that it gets.
        has_runs = self.owner_facts is None or self.owner_facts.is_caught_up
        batch = self._source.since(self._cursor, now, limit_bytes if has_runs else 0, joins=True)
        held = self._source.held
        collection: CollectionFacts | None = collection_of(held)
        advance = self._source.advanced_to
        cleared, self._cleared = self._cleared, None
        known_collection, known_advance = self._sent
        if self._is_exact and self.next_seq < held.next_seq:
            collection, advance = known_collection, known_advance
        if (
            self.next_seq == before
            and owner_part is None
            and (known_collection, known_advance) == (collection, advance)
        ):
            return None
        self._sent = collection, advance
        part = FeedPart(
            before,
            cleared,
            tuple(one.slice for one in batch.slices),
            self.next_seq,
            None if collection == known_collection else collection,
            None if advance == known_advance else advance,
            owner_part,
        )
        return part if self.owner_facts is None or self._source.acceptances is None else self._with_instants(part)

    def _with_instants(self, part: FeedPart) -> FeedPart:
        """The part with the instants of acceptance of its items and of its advance."""
        known = self._source.acceptances
        assert known is not None, "the channel is recorded"
        rows = known.between(part.first_seq, part.next_seq) if part.slices else None
        return part._replace(accepted=rows, advanced=None if part.advance is None else known.advance)

    def take_ahead(self, item: NewItem) -> FedItem | None:
        """The next part, if it has only the run `item`. The source has accepted the run, and must store it next.

        Moves the place. The items that the source collects because of this run leave the copy with a later part. None
        if the copy needs more facts: call `take` when the run is stored.
        """
        held = self._source.held
        is_next = self._cursor.next_seq == item.seq == held.next_seq
        is_newest = held.newest is not None and item.time >= held.newest
        return self._fed(item) if is_next and is_newest and self.owner_facts is not None else None

    def take_newest(self, limit_bytes: int) -> FedItem | None:
        """The next part for a copy without the owner's facts, if the part is only the run that the source stored last.

        Moves the place of the feed. Returns None, and does not move the place, if the part has more, or if a run of
        several items is above the limit; then call `take`. Items that became too old since then leave in a later part.
        """
        held = self._source.held
        newest = held.index.newest_from(self.next_seq, held.floor)
        item = None if newest is None or self.owner_facts is not None else new_item(newest)
        if item is None or item.end_seq != held.next_seq or limit_bytes <= 0:
            return None
        return self._fed(item) if item.items == 1 or item.charge_bytes <= limit_bytes else None

    def _fed(self, item: NewItem) -> FedItem | None:
        """The part with this run, the next one, and with the present floor. Moves the place. None: more has changed."""
        known, advance = self._sent
        if self._cursor.losses or self._cleared is not None or advance != self._source.advanced_to:
            return None
        present = collection_of(self._source.held)
        collected = None if present == known else _new_floor(known, present)
        if (collected is None and present != known) or not (
            self.owner_facts is None or self.owner_facts.pass_put(item)
        ):
            return None
        self._sent = present, advance
        self._cursor.pass_next(item.seq, item.items)
        return FedItem(item, collected)

    def close(self) -> None:
        """End the feed. Idempotent."""
        held, _ = self._source.look(0)
        held.report_resets_to(self._note_reset, stop=True)

    def _note_reset(self, floor: ItemKey) -> None:
        self._cleared = floor if self._cleared is None else max(self._cleared, floor)


def _new_floor(known: CollectionFacts | None, present: CollectionFacts) -> NewFloor | None:
    """The difference of two collections; None if it has more than the fields of a `NewFloor`."""
    floor, newest, end = present.floor, present.newest_collected, present.collected_end
    if known is None or newest is None or end is None:
        return None
    is_plain = known[1:3] == present[1:3] and known[5:] == present[5:]  # the fields that a `NewFloor` lacks
    return NewFloor(floor, newest, end) if is_plain else None


def _continues(source: ChannelCore, held: Holdings, place: FeedPlace | None, *, follows: bool) -> bool:
    """Whether a feed from this source can continue at `place`. Raises Unavailable."""
    if place is None:
        return True
    if place.incarnation != source.incarnation:
        return False
    if place.floor_resets > held.floor_resets or place.next_seq > held.next_seq:
        if not follows:
            return False
        raise Unavailable(
            f"this host has the channel up to seq {held.next_seq - 1}, and the copy has more items; ask "
            "again soon, or ask the owner"
        )
    return place.floor_resets == held.floor_resets


def collection_of(held: Holdings) -> CollectionFacts:
    """The items that retention has collected from a channel."""
    return CollectionFacts(
        held.floor,
        held.floor_resets,
        held.last_cause,
        held.newest_collected,
        held.collected_end,
        held.collected_by,
        held.newest_consumed,
        held.frontier_max,
    )
