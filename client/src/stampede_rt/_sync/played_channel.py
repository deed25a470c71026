# Generated from ../_async by tools/generate.py; do not edit.
"""A channel into which a replay or an import puts items."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.producer import Producer
from stampede_rt._sync.session import Session
from stampede_rt.errors import ChannelNotFound, InvalidArgument, StampedeError
from stampede_rt.files.entries import FileEntry
from stampede_rt.files.schedule import Schedule
from stampede_rt.values.model import Policy
from stampede_rt.values.policy import MAX_FUTURE_DEFAULT_NANOS, parse_name, parse_policy
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.statistics import ChannelStats
from stampede_rt.values.timeline import format_duration, format_instant

GAP_ATTRIBUTE = "stampede.gap"
GAPS_MARKED_MAX = 16  # the most gaps in the attribute of one item
PUT_TIMEOUT_S = 60.0


class PlayedChannel:
    """Puts items without waiting for each ack, in the order of the file. An advance waits for the items before it."""

    def __init__(self, channel: Channel) -> None:
        self.name = channel.name
        self._channel = channel
        self._producer: Producer = channel.producer()
        self._gaps: list[RecordingGap] = []  # the next item gets them as an attribute
        self.advances = self._refused_here = self._collected_before = 0
        self.first_refusal = ""

    @classmethod
    def open(cls, session: Session, name: str) -> PlayedChannel | None:
        """Open the channel; None if it does not exist."""
        try:
            info = session.open_channel(parse_name(name), Policy(), None, False)
        except ChannelNotFound:
            return None
        return cls(Channel(session, session.state_of(info, Policy(), False)))

    @classmethod
    def create(cls, session: Session, name: str, policy: dict[str, Any]) -> PlayedChannel:
        """Create the channel, or open the channel that another caller has created meanwhile."""
        stated = parse_policy(**policy)
        info = session.open_channel(parse_name(name), stated, None, True)
        return cls(Channel(session, session.state_of(info, stated, True)))

    @property
    def accepted(self) -> int:
        """The number of accepted items."""
        return self._producer.accepted

    @property
    def refused(self) -> int:
        """The number of refused items and advances."""
        return self._producer.rejections + self._refused_here

    def check(self, first: int, last: int, schedule: Schedule) -> None:
        """Raise InvalidArgument if the channel would refuse items between these times of the file."""
        stats = self._channel.stats()
        self._collected_before = _collected(stats)
        begins, ends = schedule.shifted(first), schedule.shifted(last)
        takes, policy = schedule.due_nanos(last), stats.policy
        future = MAX_FUTURE_DEFAULT_NANOS if policy.max_future_nanos is None else policy.max_future_nanos
        max_age = policy.effective_max_age_nanos
        if max_age is not None and begins < stats.host_time + schedule.due_nanos(first) - max_age:
            why = f"it keeps items for {format_duration(max_age)}"
        elif stats.advance is not None and begins < stats.advance:
            why = f"its producers have promised nothing before {format_instant(stats.advance)}"
        elif stats.frontier is not None and begins < stats.frontier:
            why = f"it has collected items before {format_instant(stats.frontier)}"
        elif ends > stats.host_time + takes + future:
            why = f"items may be at most {format_duration(future)} ahead of the host's clock"
        else:
            return
        raise InvalidArgument(
            f"channel {self.name!r} would refuse items of the file: {why}, and their times would be "
            f"{format_instant(begins)} to {format_instant(ends)}; shift them to now, or choose another prefix"
        )

    def put(self, entry: FileEntry, time: int) -> None:
        """Put an item. The first one after a gap gets the attribute `stampede.gap`. Raises Unavailable."""
        attributes = dict(entry.attributes)
        if self._gaps:
            attributes[GAP_ATTRIBUTE] = gap_attribute(self._gaps)
            self._gaps.clear()
        try:
            self._producer.put(
                entry.data,
                time=time,
                duration=entry.duration,
                attributes=attributes,
                content_type=entry.content_type or None,
                timeout=PUT_TIMEOUT_S,
            )
        except InvalidArgument as error:  # no channel accepts such an item, for example because it is too large
            self._note_refusal(error)

    def note_gap(self, gap: RecordingGap) -> None:
        """Mark the next item, to say that items before it are missing."""
        if len(self._gaps) < GAPS_MARKED_MAX:
            self._gaps.append(gap)

    def advance(self, time: int) -> None:
        """Advance the channel, after all items before."""
        self.flush()
        try:
            self._channel.advance(time)
            self.advances += 1
        except InvalidArgument:
            raise
        except StampedeError as error:
            if error.retryable:
                raise
            self._note_refusal(error)

    def _note_refusal(self, error: StampedeError) -> None:
        self._refused_here += 1
        self.first_refusal = self.first_refusal or error.message

    def flush(self) -> None:
        """Wait until the host has accepted or refused all items. Raises Unavailable, ChannelNotFound."""
        noted = self._producer.rejected
        try:
            self._producer.flush(PUT_TIMEOUT_S)
        except StampedeError as error:
            if self._producer.rejected is noted:  # not a refusal of an item: the channel cannot be reached, or is gone
                raise
            self.first_refusal = self.first_refusal or error.message

    def collected(self) -> int:
        """The number of items that the limits of the channel have collected since `check`, and that no archive has."""
        return max(0, _collected(self._channel.stats()) - self._collected_before)

    def close(self) -> None:
        """Close the stream of puts."""
        self._producer.close()


def _collected(stats: ChannelStats) -> int:
    """The items that the limits have collected; 0 for a recorded channel, whose archive has them."""
    return 0 if stats.policy.is_recorded else sum(stats.collected.values()) - stats.collected["consumption"]


def gap_attribute(gaps: Sequence[RecordingGap]) -> str:
    """Return the value of the attribute `stampede.gap` for the gaps between two items."""
    return ", ".join(f"{'?' if one.items is None else one.items} items {one.reason}" for one in gaps)
