"""The channels about which this host asks one other host, with a share for each creator of groups. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, KeysView


class WantedChannels:
    """The channels that groups need of another host. `requested` are at most `limit` of them.

    A channel counts for one of the callers that created its groups. If there are more channels than `limit`, a channel
    of a creator with few channels replaces the newest channel of the creator with the most channels. So the groups of
    one caller do not leave out the groups of other callers. The time of a step does not depend on the number of
    channels, groups or creators.
    """

    def __init__(self, limit: int) -> None:
        self.changes = 0  # how often `requested` has changed so far
        self._limit = limit
        self._creators: dict[bytes, Counter[str]] = {}  # by channel: the number of its groups of each creator
        self._creator_of: dict[bytes, str] = {}  # by channel for which this host asks: the creator for whom it counts
        self._requested: dict[str, dict[bytes, None]] = {}  # by creator: the channels of `_creator_of`, the newest last
        self._left_out: dict[str, dict[bytes, None]] = {}  # by creator: the other channels of the creator's groups
        self._with_count: dict[int, dict[str, None]] = {}  # by number of channels in `_requested`: the creators
        self._largest_count = 0  # the highest key of `_with_count`

    def __bool__(self) -> bool:
        return bool(self._creators)

    @property
    def requested(self) -> KeysView[bytes]:
        """The channels to ask for. The view follows later changes."""
        return self._creator_of.keys()

    @property
    def left_out(self) -> int:
        """The number of channels beyond `limit`."""
        return len(self._creators) - len(self._creator_of)

    @property
    def largest_creator(self) -> str:
        """The creator for whom most channels count. There is at least one channel."""
        return next(iter(self._with_count[self._largest_count]))

    def add(self, creator: str, channel_ids: Iterable[bytes]) -> None:
        """Note that a group of this creator has these channels now."""
        for channel_id in channel_ids:
            creators = self._creators.setdefault(channel_id, Counter())
            creators[creator] += 1
            if channel_id in self._creator_of:
                continue
            if len(self._creator_of) < self._limit or self._make_room(creator):
                self._ask(channel_id, creator)
            else:
                self._left_out.setdefault(creator, {})[channel_id] = None

    def remove(self, creator: str, channel_ids: Iterable[bytes]) -> None:
        """Note that a group of this creator no longer has these channels."""
        for channel_id in channel_ids:
            creators = self._creators[channel_id]
            creators[creator] -= 1
            if creators[creator]:
                continue
            del creators[creator]
            if not creators:
                del self._creators[channel_id]
            if self._creator_of.get(channel_id) != creator:
                self._let_in(channel_id, (creator,))
                continue
            self._ask_no_more(channel_id)
            if creators:
                self._ask(channel_id, next(iter(creators)))
            else:
                self._fill(creator)

    def _make_room(self, creator: str) -> bool:
        """Leave out the newest channel of a creator that has at least two channels more than this creator.

        Returns False if there is no such creator.
        """
        while self._largest_count > len(self._requested.get(creator, ())) + 1:
            largest = self.largest_creator
            channel_id = next(reversed(self._requested[largest]))
            creators = self._creators[channel_id]
            self._ask_no_more(channel_id)
            next_creator = next(
                (one for one in creators if len(self._requested.get(one, ())) + 1 < self._largest_count), None
            )
            if next_creator is None:
                for one in creators:
                    self._left_out.setdefault(one, {})[channel_id] = None
                return True
            self._ask(channel_id, next_creator)  # from now on the channel counts for another creator
        return False

    def _fill(self, creator: str) -> None:
        """Ask for a channel that was left out: one of this creator, or if there is none, one of the next creator."""
        if self._left_out:
            next_creator = creator if creator in self._left_out else next(iter(self._left_out))
            left_out = self._left_out.pop(next_creator)
            channel_id = next(iter(left_out))
            self._left_out[next_creator] = left_out  # the creators take turns
            self._ask(channel_id, next_creator)

    def _ask(self, channel_id: bytes, creator: str) -> None:
        self._let_in(channel_id, self._creators[channel_id])
        self._creator_of[channel_id] = creator
        self.changes += 1
        self._note_count(creator, +1)
        self._requested.setdefault(creator, {})[channel_id] = None

    def _ask_no_more(self, channel_id: bytes) -> None:
        creator = self._creator_of.pop(channel_id)
        self.changes += 1
        self._note_count(creator, -1)
        del self._requested[creator][channel_id]
        if not self._requested[creator]:
            del self._requested[creator]

    def _let_in(self, channel_id: bytes, creators: Iterable[str]) -> None:
        """Note that the channel is no longer left out."""
        for creator in creators:
            left_out = self._left_out.get(creator, {})
            left_out.pop(channel_id, None)
            if not left_out:
                self._left_out.pop(creator, None)

    def _note_count(self, creator: str, step: int) -> None:
        """Enter the creator under its new number of channels, and update `_largest_count`. `step`: 1 or -1."""
        count = len(self._requested.get(creator, ()))
        if count:
            creators = self._with_count[count]
            del creators[creator]
            if not creators:
                del self._with_count[count]
        if count + step:
            self._with_count.setdefault(count + step, {})[creator] = None
        if count + step > self._largest_count or (count == self._largest_count and count not in self._with_count):
            self._largest_count = count + step
