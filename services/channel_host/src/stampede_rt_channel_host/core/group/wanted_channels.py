"""The channels about which this host asks one other host, with a share for each maker of groups. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, KeysView


class WantedChannels:
    """The channels that groups need of another host. `asked` are at most `limit` of them.

    A channel counts for one of the callers that made its groups. If there are more channels than `limit`, a channel of
    a maker with few channels replaces the newest channel of the maker with the most channels. So the groups of one
    caller do not leave out the groups of other callers. No step depends on the number of channels, groups or makers.
    """

    def __init__(self, limit: int) -> None:
        self.changes = 0  # how often `asked` has changed so far
        self._limit = limit
        self._makers: dict[bytes, Counter[str]] = {}  # by channel: the number of its groups of each maker
        self._maker_of: dict[bytes, str] = {}  # by channel for which this host asks: the maker for whom it counts
        self._asked: dict[str, dict[bytes, None]] = {}  # by maker: the channels of `_maker_of`, the newest last
        self._left_out: dict[str, dict[bytes, None]] = {}  # by maker: the other channels of the maker's groups
        self._with_count: dict[int, dict[str, None]] = {}  # by number of channels in `_asked`: the makers
        self._most = 0  # the highest key of `_with_count`

    def __bool__(self) -> bool:
        return bool(self._makers)

    @property
    def asked(self) -> KeysView[bytes]:
        """The channels to ask for. The view follows later changes."""
        return self._maker_of.keys()

    @property
    def left_out(self) -> int:
        """The number of channels beyond `limit`."""
        return len(self._makers) - len(self._maker_of)

    @property
    def largest_maker(self) -> str:
        """The maker for whom most channels count. There is at least one channel."""
        return next(iter(self._with_count[self._most]))

    def add(self, maker: str, channel_ids: Iterable[bytes]) -> None:
        """Note that a group of this maker has these channels now."""
        for channel_id in channel_ids:
            makers = self._makers.setdefault(channel_id, Counter())
            makers[maker] += 1
            if channel_id in self._maker_of:
                continue
            if len(self._maker_of) < self._limit or self._make_room(maker):
                self._ask(channel_id, maker)
            else:
                self._left_out.setdefault(maker, {})[channel_id] = None

    def remove(self, maker: str, channel_ids: Iterable[bytes]) -> None:
        """Note that a group of this maker no longer has these channels."""
        for channel_id in channel_ids:
            makers = self._makers[channel_id]
            makers[maker] -= 1
            if makers[maker]:
                continue
            del makers[maker]
            if not makers:
                del self._makers[channel_id]
            if self._maker_of.get(channel_id) != maker:
                self._let_in(channel_id, (maker,))
                continue
            self._ask_no_more(channel_id)
            if makers:
                self._ask(channel_id, next(iter(makers)))
            else:
                self._fill(maker)

    def _make_room(self, maker: str) -> bool:
        """Leave out the newest channel of a maker that has at least two more than this maker. False: there is no such
        maker.
        """
        while self._most > len(self._asked.get(maker, ())) + 1:
            largest = self.largest_maker
            channel_id = next(reversed(self._asked[largest]))
            makers = self._makers[channel_id]
            self._ask_no_more(channel_id)
            next_maker = next((one for one in makers if len(self._asked.get(one, ())) + 1 < self._most), None)
            if next_maker is None:
                for one in makers:
                    self._left_out.setdefault(one, {})[channel_id] = None
                return True
            self._ask(channel_id, next_maker)  # from now on the channel counts for another maker
        return False

    def _fill(self, maker: str) -> None:
        """Ask for a channel that was left out: one of this maker, or if there is none, one of the next maker."""
        if self._left_out:
            next_maker = maker if maker in self._left_out else next(iter(self._left_out))
            left_out = self._left_out.pop(next_maker)
            channel_id = next(iter(left_out))
            self._left_out[next_maker] = left_out  # the makers take turns
            self._ask(channel_id, next_maker)

    def _ask(self, channel_id: bytes, maker: str) -> None:
        self._let_in(channel_id, self._makers[channel_id])
        self._maker_of[channel_id] = maker
        self.changes += 1
        self._note_count(maker, +1)
        self._asked.setdefault(maker, {})[channel_id] = None

    def _ask_no_more(self, channel_id: bytes) -> None:
        maker = self._maker_of.pop(channel_id)
        self.changes += 1
        self._note_count(maker, -1)
        del self._asked[maker][channel_id]
        if not self._asked[maker]:
            del self._asked[maker]

    def _let_in(self, channel_id: bytes, makers: Iterable[str]) -> None:
        """Note that the channel is no longer left out."""
        for maker in makers:
            left_out = self._left_out.get(maker, {})
            left_out.pop(channel_id, None)
            if not left_out:
                self._left_out.pop(maker, None)

    def _note_count(self, maker: str, step: int) -> None:
        """Move the maker to its new number of channels. `_most` follows, because each step is 1."""
        count = len(self._asked.get(maker, ()))
        if count:
            of_count = self._with_count[count]
            del of_count[maker]
            if not of_count:
                del self._with_count[count]
        if count + step:
            self._with_count.setdefault(count + step, {})[maker] = None
        if count + step > self._most or (count == self._most and count not in self._with_count):
            self._most = count + step
