# Generated from ../_async by tools/generate.py; do not edit.
"""Matches from archives: which items of recorded channels match, as of an instant of the hosts' clocks."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from stampede_rt._sync.reader import Reader
from stampede_rt.errors import InvalidArgument, Overloaded
from stampede_rt.matching.item_keys import FIRST_KEY, ItemKey
from stampede_rt.matching.key_matcher import KeyMatch, KeyMatcher, has_passed
from stampede_rt.transports.concurrency_sync import run_all
from stampede_rt.values.answers import Items, PastState
from stampede_rt.values.grouping import GroupInfo, Matched
from stampede_rt.values.match_rule import MatchRule
from stampede_rt.values.model import Item, Reason
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import (
    ALL_TIME,
    MAX_INSTANT,
    MIN_INSTANT,
    Bound,
    Interval,
    Match,
    clamp,
    parse_interval,
)

ReadAsOf = Callable[[ReadQuery, int], Items]

KEYS_MAX = 2**18
"""The most keys of items that wait for a match, of all members together: about 35 MB."""
KEYS_PER_PAGE = 2**13
ITEMS_PER_READ = 16
"""The most items of one instant that one read fetches for the next matches."""
_NEWEST = ReadQuery(ALL_TIME, match=Match.START, limit=1, newest_first=True, payloads=False)


class ArchivedMember:
    """One member of a group as of an instant: how far it had come, and its keys, page by page in the order of time.

    `reason`: why the archive may not have all items of the member; None: it has all.
    """

    def __init__(self, channel: Reader, read_as_of: ReadAsOf) -> None:
        self.channel, self.read_as_of = channel, read_as_of
        self.id = channel.info.channel_id
        self.newest: Item | None = None
        self.past: PastState | None = None
        self.newest_time: int | None = None
        self.advance: int | None = None
        self.reason: Reason | None = None
        self.loaded_to: int = MIN_INSTANT  # the caller has all keys up to this time
        self._start = self.loaded_to
        self._after: Item | None = None
        self._fetched: dict[ItemKey, Item] = {}  # some items of one instant, as of the last read

    def begin(self, as_of: int) -> None:
        """Find out how far the channel had come."""
        found = self.read_as_of(_NEWEST, as_of)
        self._note(found, is_partial=bool(found))
        self.newest, self.past = (found[0] if found else None), found.past
        self.newest_time = self.newest and self.newest.time
        self.advance = None if found.past is None else found.past.advance

    def _note(self, items: Items, *, is_partial: bool = False) -> None:
        has_lost_items = items.reason == "LOST" or (items.reason == "COLLECTED" and not is_partial)
        if has_lost_items and self.reason is None and items.reason is not None:
            name, reason = self.channel.name, items.reason
            self.reason = Reason(reason, f"channel {name}: {reason.detail}")

    def skip_to(self, time: int) -> None:
        """Leave out the keys before `time`."""
        self._start = max(self._start, time)
        self.loaded_to = max(self.loaded_to, clamp(time - 1))

    @property
    def is_over(self) -> bool:
        """Whether the caller has all keys."""
        return self.loaded_to == MAX_INSTANT

    def next_page(self, as_of: int) -> list[ItemKey]:
        """Return the next keys."""
        query = ReadQuery(
            parse_interval(self._start, MAX_INSTANT),
            match=Match.START,
            limit=KEYS_PER_PAGE,
            after=self._after,
            payloads=False,
        )
        page = self.read_as_of(query, as_of)
        self._note(page)
        self._after = page[-1] if page else None
        # The next page may have more of the last bucket.
        self.loaded_to = page[-1].time - 1 if page.more else MAX_INSTANT
        return list(zip(page.times, page.seqs, strict=True))

    def has_passed(self, instant: int, lateness_nanos: int) -> bool:
        """Return whether no further item can come at or before `instant`, and the caller has all keys up to it."""
        return self.loaded_to >= instant and has_passed(self.newest_time, self.advance, instant, lateness_nanos)

    def item(self, key: ItemKey, as_of: int, *, payloads: bool) -> Item | None:
        """Return an item; None if the archive does not have it any more."""
        if key not in self._fetched:
            time, seq = key
            before = Item(time, None, None, seq - 1, b"", {}, "", 0, 0)
            window = parse_interval(time, time)
            query = ReadQuery(window, match=Match.START, limit=ITEMS_PER_READ, after=before, payloads=payloads)
            self._fetched = {(one.time, one.seq): one for one in self.read_as_of(query, as_of)}
        return self._fetched.get(key)


class ArchivedMatching:
    """Finds the matches of a group's items as of `as_of`, which the caller may move forward.

    `unmatched` and `dropped` count as in a live subscription.
    """

    def __init__(
        self, group: GroupInfo, members: Sequence[ArchivedMember], per: ArchivedMember, rule: MatchRule
    ) -> None:
        check_idle(group)
        self.members = tuple(members)
        self._per, self._rule = per, rule
        self._by_id = {one.id: one for one in members}
        self._matcher = KeyMatcher(per.id, (), rule.tolerance_nanos, FIRST_KEY, unique=rule.unique)
        self.as_of = 0
        self.unmatched = 0
        self.dropped = 0

    @property
    def reason(self) -> Reason | None:
        """Why matches may be missing, or differ from the matches of a live reader; None: the archives have all."""
        return next((one.reason for one in self.members if one.reason is not None), None)

    def begin(self, as_of: int) -> None:
        """Begin with the items from the rule's `start` on, or after the newest item of `per`."""
        self.as_of = as_of
        run_all([functools.partial(one.begin, as_of) for one in self.members])
        low = self._low()
        others = [one.id for one in self.members if one is not self._per]
        self._matcher = KeyMatcher(self._per.id, others, self._rule.tolerance_nanos, low, unique=self._rule.unique)
        for one in self.members:
            one.skip_to(clamp(low[0] if one is self._per else low[0] - self._rule.tolerance_nanos))

    def _low(self) -> ItemKey:
        """Return the key at or above which the items of `per` get a match."""
        newest, start = self._per.newest, self._rule.start
        if start is None:
            return FIRST_KEY if newest is None else (newest.time, newest.seq + 1)
        return (start.offset, 0) if start.meta is None else self._resolved(start)

    def _resolved(self, start: Bound) -> ItemKey:
        query = ReadQuery(Interval(start, start), match=Match.START, limit=1, payloads=False)
        within = (self._per.read_as_of(query, self.as_of)).interval
        return FIRST_KEY if within is None else (within.start, 0)  # None: there was no item yet

    def next_match(self) -> KeyMatch | None:
        """Return the next match that was decided at `as_of`; None if there is no further one."""
        while (found := self._matcher.take(self._has_passed)) is None:
            if self._per.is_over and self._matcher.next_time is None:
                return None
            if not self._load():
                return None
        return found

    def load_all(self) -> None:
        """Load all keys that later matches may need."""
        while self._load():
            pass

    def _load(self) -> bool:
        """Load the next keys of the member whose keys end first. Returns False if there are no more.

        Raises Overloaded as `check_room`.
        """
        due = min((one for one in self.members if not one.is_over), key=lambda one: one.loaded_to, default=None)
        if due is None:
            return False
        self.check_room()
        time = self._matcher.next_time
        if due is not self._per and time is not None:
            due.skip_to(clamp(time - self._rule.tolerance_nanos))
        self.add(due.id, due.next_page(self.as_of))
        return True

    def _has_passed(self, channel_id: bytes, instant: int) -> bool:
        return self._by_id[channel_id].has_passed(instant, self._rule.lateness_nanos)

    def add(self, channel_id: bytes, keys: Iterable[ItemKey]) -> None:
        """Add keys of a member. Call `check_room` before the read that returns them."""
        self.dropped += self._matcher.add(channel_id, keys)

    def check_room(self) -> None:
        """Check that there is room for further keys. Raises Overloaded beyond KEYS_MAX. In this case nothing has
        changed, so a repeated step takes no more memory.
        """
        if len(self._matcher) > KEYS_MAX:
            behind = min(self.members, key=lambda one: (one.newest_time is not None, one.newest_time or 0)).channel
            raise Overloaded(
                f"the matching would hold more than {KEYS_MAX} items until channel {behind.name!r} has passed their "
                "times; match with a smaller tolerance, or without that channel"
            )

    def matched(self, found: KeyMatch) -> Matched[Any] | None:
        """Return the items of a match, and count it; None if the archive does not have the item of `per` any more."""
        keys = {self._per.id: found.key, **found.partners}
        wanted = [self._by_id[one] for one in keys]
        reads = [functools.partial(one.item, keys[one.id], self.as_of, payloads=self._rule.payloads) for one in wanted]
        items = dict(zip(keys, run_all(reads), strict=True))
        held = {one: item for one, item in items.items() if item is not None}
        self.dropped += len(items) - len(held)
        missing = [one.channel for one in self.members if one.id not in held]
        self.unmatched += len(items) == len(held) and bool(missing)
        if self._per.id not in held:
            return None
        return Matched([one.channel for one in self.members], held, missing=missing, time=found.key[0])

    def wants(self, matched: Matched[Any]) -> bool:
        """Return whether the reader gets this match: `partial` decides if items are missing."""
        return self._rule.partial or not matched.missing


def check_idle(group: GroupInfo) -> None:
    """Raise InvalidArgument if matches of the group depend on facts that archives do not have."""
    if group.idle_after_nanos is not None:
        raise InvalidArgument(
            f"the past matches of group {group.name!r} are not known: idle_after left silent members out, and archives "
            "do not show when; match a group without idle_after"
        )
