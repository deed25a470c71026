"""How far channels are: the timestamps that groups broadcast (paper, section 4.1). Pure.

Instants are int nanoseconds since the epoch, durations int nanoseconds.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.channel import ABSENT, ChannelCore, Slice
from stampede_rt_channel_host.core.group.ledger import newest_gone


class ChannelTimes(NamedTuple):
    """How far one channel is, as its owner tells. Within an incarnation nothing of it ever shrinks.

    `newest`: the newest item's time; `newest_end`: the latest end by duration in that item's bucket, None if none of
    its items has one; `advance`: the highest promise. None: there never was one.
    """

    epoch: int
    incarnation: int
    newest: int | None = None
    newest_end: int | None = None
    advance: int | None = None

    @property
    def mark(self) -> int | None:
        """The later of newest and advance."""
        return _later(self.newest, self.advance)

    def has_passed(self, instant: int, lateness_nanos: int = 0) -> bool:
        """No item can be at or before `instant` any more, if none is further behind the newest than `lateness_nanos`.
        0: they come in order, other than into the newest bucket. What an advance has excluded never comes."""
        by_item = self.newest is not None and self.newest - lateness_nanos >= instant + bool(lateness_nanos)
        return by_item or (self.advance is not None and self.advance > instant)

    def merged(self, told: ChannelTimes) -> ChannelTimes:
        """These times and `told`, by the same owner or a later one: the further of both, or another life's alone."""
        if told.incarnation != self.incarnation:
            return told
        newest, newest_end = max((self.newest, self.newest_end), (told.newest, told.newest_end), key=_order)
        return ChannelTimes(told.epoch, told.incarnation, newest, newest_end, _later(self.advance, told.advance))


def _later(one: int | None, other: int | None) -> int | None:
    if one is None or other is None:
        return one if other is None else other
    return max(one, other)


def _order(newest: tuple[int | None, int | None]) -> tuple[bool, int, bool, int]:
    time, end = newest
    return time is not None, time or 0, end is not None, end or 0


class OwnTimes:
    """Follows one channel of this host; `observe` after each change of it. Costs what was put since.

    `silent_since`: the host's clock at the last put or advance, or when this began to look.
    """

    def __init__(self, channel: ChannelCore, now: int) -> None:
        self._channel = channel
        self._newest: int | None = None
        self._newest_end: int | None = None
        self._advance: int | None = None
        self._seen_seq = 1
        self.silent_since = now
        self.observe(now)

    def observe(self, now: int) -> bool:
        """Look at what was put since the last time; True if the times have changed."""
        channel = self._channel
        if channel.next_seq == self._seen_seq and channel.advanced_to == self._advance:
            return False
        before = self._newest, self._newest_end, self._advance
        held, _ = channel.look(now)
        for part in held.slices_by_seq(self._seen_seq, channel.next_seq):
            self._take(part)
        gone = newest_gone(held)
        if gone is not None and (self._newest is None or gone > self._newest):  # before this began to look
            self._newest, self._newest_end = gone, None
        self._seen_seq, self._advance, self.silent_since = channel.next_seq, channel.advanced_to, now
        return before != (self._newest, self._newest_end, self._advance)

    def times(self, epoch: int) -> ChannelTimes:
        """As of the last look, under the epoch in which the host owns the channel."""
        return ChannelTimes(epoch, self._channel.incarnation, self._newest, self._newest_end, self._advance)

    def _take(self, part: Slice) -> None:
        last = part.last_time
        if self._newest is not None and last < self._newest:
            return
        if self._newest is None or last > self._newest:
            self._newest, self._newest_end = last, None
        durations = part.run.durations
        if durations is None:
            return
        for at in range(bisect_left(part.run.times, last, part.lo, part.hi), part.hi):
            if durations[at] != ABSENT:
                self._newest_end = _later(self._newest_end, clamp(last + durations[at]))


@dataclass(slots=True)
class Heard:
    """The facts that a host knows of one channel. All instants are its own clock's.

    `known_until`: up to when it knows whether the channel is silent; None: it owns the channel and always knows.
    """

    times: ChannelTimes
    silent_since: int
    known_until: int | None

    def silent_nanos(self, now: int) -> int:
        """For how long the channel had no put and no advance, as far as is known."""
        return max(0, (now if self.known_until is None else self.known_until) - self.silent_since)

    def heard_ago_nanos(self, now: int) -> int:
        """How old this knowledge is; 0 for a channel of this host."""
        return 0 if self.known_until is None else max(0, now - self.known_until)


class TimesBoard:
    """The facts that a host knows of the channels of its groups: one for each host, shared by the groups.

    `setbacks`: how often a channel fell behind what was known of it, since its host was lost. Otherwise it only grows.
    """

    def __init__(self) -> None:
        self.setbacks = 0
        self._heard: dict[bytes, Heard] = {}

    def find(self, channel_id: bytes) -> Heard | None:
        """The known facts of the channel; None: it was never heard of."""
        return self._heard.get(channel_id)

    def tell_own(self, channel_id: bytes, times: ChannelTimes, silent_since: int) -> None:
        """The host owns the channel, and this is how far it is; nothing, if another owner has been heard of since."""
        held = self._heard.get(channel_id)
        if held is not None and times.epoch < held.times.epoch:
            return
        self._heard[channel_id] = Heard(times if held is None else self._merged(held, times), silent_since, None)

    def disown(self, channel_id: bytes, now: int) -> None:
        """The host does not own the channel any more: from now on others have to tell how far it is."""
        held = self._heard.get(channel_id)
        if held is not None and held.known_until is None:
            held.known_until = now

    def hear(self, channel_id: bytes, times: ChannelTimes, silent_nanos: int, now: int) -> bool:
        """The channel's owner has told how far it is; True if that is news. Words of a former owner change nothing."""
        held = self._heard.get(channel_id)
        if held is None:
            self._heard[channel_id] = Heard(times, now - silent_nanos, now)
            return True
        if times.epoch < held.times.epoch or (held.known_until is None and times.epoch == held.times.epoch):
            return False
        merged = self._merged(held, times)
        news = merged != held.times
        held.times, held.silent_since, held.known_until = merged, now - silent_nanos, now
        return news

    def confirm(self, channel_ids: Iterable[bytes], now: int) -> None:
        """Their owner gave a sign of life: had there been a change, it would have told."""
        for channel_id in channel_ids:
            held = self._heard.get(channel_id)
            if held is not None and held.known_until is not None:
                held.known_until = max(held.known_until, now)

    def forget(self, channel_id: bytes) -> None:
        """No group has that channel any more. Idempotent."""
        self._heard.pop(channel_id, None)

    def _merged(self, held: Heard, told: ChannelTimes) -> ChannelTimes:
        self.setbacks += told.incarnation != held.times.incarnation
        return held.times.merged(told)
