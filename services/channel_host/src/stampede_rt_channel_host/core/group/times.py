"""The times that hosts report to each other about the channels of their groups (paper, section 4.1). Pure.

Instants are int nanoseconds since the epoch, durations int nanoseconds.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from stampede_rt.matching.key_matcher import has_passed
from stampede_rt.values.timeline import clamp
from stampede_rt_channel_host.core.channel import ABSENT, ChannelCore, Slice
from stampede_rt_channel_host.core.group.loss_counter import newest_gone


class ChannelTimes(NamedTuple):
    """The times of one channel, by its owner's report. Within an incarnation `newest` and `advance` never move back.

    `newest` is the newest item's time, or None if there never was an item. `newest_end` is the latest end by duration
    in that item's bucket, or None if no item of the bucket has a duration. `advance` is the highest instant of an
    advance, or None if there never was an advance.
    """

    epoch: int
    incarnation: int
    newest: int | None = None
    newest_end: int | None = None
    advance: int | None = None

    @property
    def mark(self) -> int | None:
        """The later of `newest` and `advance`, or None if both are None."""
        return _later(self.newest, self.advance)

    def has_passed(self, instant: int, lateness_nanos: int = 0) -> bool:
        """Whether no item can come at or before `instant`, if every item is at most `lateness_nanos` behind the newest.

        A lateness of 0 says that items come in order. Then the method returns True as soon as the newest item is at
        `instant`, although more items with the same time may come. No item comes before an advance.
        """
        return has_passed(self.newest, self.advance, instant, lateness_nanos)

    def merged(self, reported: ChannelTimes) -> ChannelTimes:
        """These times joined with `reported`, which the same owner or a later owner has sent.

        Within one incarnation the result has the later times. If `reported` is of another incarnation, the result is
        `reported`.
        """
        if reported.incarnation != self.incarnation:
            return reported
        newest, newest_end = max((self.newest, self.newest_end), (reported.newest, reported.newest_end), key=_order)
        return ChannelTimes(
            reported.epoch, reported.incarnation, newest, newest_end, _later(self.advance, reported.advance)
        )


def _later(one: int | None, other: int | None) -> int | None:
    if one is None or other is None:
        return one if other is None else other
    return max(one, other)


def _order(newest: tuple[int | None, int | None]) -> tuple[bool, int, bool, int]:
    """A key that sorts pairs of `newest` and `newest_end`, of which both may be None."""
    time, end = newest
    return time is not None, time or 0, end is not None, end or 0


class OwnChannelTimes:
    """Follows the times of one channel of this host. Call `observe` after each change of the channel.

    `silent_since` is the host's clock at the last put or advance, or at the start of this object.
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
        """Look at the items accepted after the last call. Returns True if the times have changed."""
        channel = self._channel
        if channel.next_seq == self._seen_seq and channel.advanced_to == self._advance:
            return False
        before = self._newest, self._newest_end, self._advance
        held, _ = channel.look(now)
        for part in held.slices_by_seq(self._seen_seq, channel.next_seq):
            self._take(part)
        gone = newest_gone(held)
        # the channel collected the newest item before this object could see it
        if gone is not None and (self._newest is None or gone > self._newest):
            self._newest, self._newest_end = gone, None
        self._seen_seq, self._advance, self.silent_since = channel.next_seq, channel.advanced_to, now
        return before != (self._newest, self._newest_end, self._advance)

    def times(self, epoch: int) -> ChannelTimes:
        """The times as of the last `observe`. `epoch` is the epoch in which the host owns the channel."""
        return ChannelTimes(epoch, self._channel.incarnation, self._newest, self._newest_end, self._advance)

    def _take(self, part: Slice) -> None:
        """Take the newest time, and the latest end by duration there, from the items of a slice."""
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
class KnownTimes:
    """A host's knowledge of one channel. `silent_since` and `known_until` are instants of that host's clock.

    The channel had no put and no advance from `silent_since` to `known_until`. Later puts and advances are not known
    yet. If `known_until` is None, the host owns the channel and always knows.
    """

    times: ChannelTimes
    silent_since: int
    known_until: int | None

    def silent_nanos(self, now: int) -> int:
        """The time since the channel's last put or advance, as far as the host knows."""
        return max(0, (now if self.known_until is None else self.known_until) - self.silent_since)

    def age_nanos(self, now: int) -> int:
        """The age of this knowledge. It is 0 for a channel of this host."""
        return 0 if self.known_until is None else max(0, now - self.known_until)


class TimesBoard:
    """A host's knowledge of the channels of its groups. Each host has one board, which all its groups share.

    `setbacks` counts how often a channel got another incarnation, because its host was lost. The times of a channel
    move back only at a setback.
    """

    def __init__(self) -> None:
        self.setbacks = 0
        self._known: dict[bytes, KnownTimes] = {}

    def find(self, channel_id: bytes) -> KnownTimes | None:
        """The host's knowledge of the channel, or None if the host knows nothing of it."""
        return self._known.get(channel_id)

    def enter_own(self, channel_id: bytes, times: ChannelTimes, silent_since: int) -> None:
        """Enter the times of a channel that the host owns. Changes nothing if the host has learned of a later owner."""
        held = self._known.get(channel_id)
        if held is not None and times.epoch < held.times.epoch:
            return
        self._known[channel_id] = KnownTimes(times if held is None else self._merged(held, times), silent_since, None)

    def disown(self, channel_id: bytes, now: int) -> None:
        """Note that the host does not own the channel any more. From now on another host must report its times."""
        held = self._known.get(channel_id)
        if held is not None and held.known_until is None:
            held.known_until = now

    def receive(self, channel_id: bytes, times: ChannelTimes, silent_nanos: int, now: int) -> bool:
        """Enter the report of a channel's owner. `silent_nanos` is the time since the last put or advance.

        Returns True if the times of the channel have changed. A report of a former owner changes nothing.
        """
        held = self._known.get(channel_id)
        if held is None:
            self._known[channel_id] = KnownTimes(times, now - silent_nanos, now)
            return True
        if times.epoch < held.times.epoch or (held.known_until is None and times.epoch == held.times.epoch):
            return False
        merged = self._merged(held, times)
        has_changed = merged != held.times
        held.times, held.silent_since, held.known_until = merged, now - silent_nanos, now
        return has_changed

    def confirm(self, channel_ids: Iterable[bytes], now: int) -> None:
        """Note a sign of life of the channels' owner, which means that their times have not changed."""
        for channel_id in channel_ids:
            held = self._known.get(channel_id)
            if held is not None and held.known_until is not None:
                held.known_until = max(held.known_until, now)

    def forget(self, channel_id: bytes) -> None:
        """Forget a channel that no group has any more. Idempotent."""
        self._known.pop(channel_id, None)

    def _merged(self, held: KnownTimes, reported: ChannelTimes) -> ChannelTimes:
        """The times joined with `reported`. Counts a setback if `reported` is of another incarnation."""
        self.setbacks += reported.incarnation != held.times.incarnation
        return held.times.merged(reported)
