"""The values that readers of groups get (paper, section 3.3). Pure.

Instants and durations are int nanoseconds. A cut is exclusive: the group shows items before it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar, get_args

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.answers import Items
from stampede_rt.values.model import ChannelInfo, Item, Reason
from stampede_rt.values.timeline import DurationLike, parse_duration

MEMBERS_MAX = 64
"""The greatest number of channels in a group."""
GroupBound = Literal["start", "end"]
"""One item moves the cut of its channel to the time of the item ("start"), or to the end of its duration ("end")."""
Over = Literal["start", "span"]
"""A cross-section has the items at the time of the reference's item ("start"), or over its whole span ("span")."""
BOUNDS: tuple[GroupBound, ...] = get_args(GroupBound)
OLDEST_REFERENCE = "oldest"  # `reference` of a group whose cut is the smallest cut of its members
MAX_LEAD_DEFAULT = "5s"  # the default of `max_lead`: how far after its time an item moves the cut at most

Value = TypeVar("Value")


class NamedChannel(Protocol):
    """A channel's handle, or a group's descriptor of the channel."""

    @property
    def info(self) -> ChannelInfo:
        """The directory's description of the channel."""


Key = TypeVar("Key", bound=NamedChannel)
OtherKey = TypeVar("OtherKey", bound=NamedChannel)


@dataclass(slots=True)
class SeenCut:
    """The group through which a reader reads, and the highest cut that the reader has seen.

    The reader sends `cut_floor` with each read. The host then does not answer with a lower cut.
    """

    group_id: bytes
    cut_floor: int | None = None

    def note_cut(self, cut: int | None) -> None:
        """Note the cut of an answer. `cut_floor` becomes this cut if it is the highest so far."""
        if cut is not None and (self.cut_floor is None or cut > self.cut_floor):
            self.cut_floor = cut


class ByChannel(Mapping[Key, Value], Generic[Key, Value]):
    """A value for each channel. The key is the channel's handle, a group's descriptor of it, or its name."""

    def __init__(self, channels: Sequence[Key], values: Mapping[bytes, Value]) -> None:
        self._channels = [channel for channel in channels if channel.info.channel_id in values]
        self._values = values

    def __getitem__(self, channel: NamedChannel | str) -> Value:
        for one in self._channels:
            if is_named_by(channel, one):
                return self._values[one.info.channel_id]
        raise KeyError(shown_name(channel))

    def __iter__(self) -> Iterator[Key]:
        return iter(self._channels)

    def __len__(self) -> int:
        return len(self._channels)

    def with_handles(self, channels: Sequence[OtherKey]) -> ByChannel[OtherKey, Value]:
        """Return the same values with other handles as keys. `channels` has a handle for each channel with a value."""
        handles = {one.info.channel_id: one for one in channels}
        return ByChannel([handles[one.info.channel_id] for one in self._channels], self._values)

    def __repr__(self) -> str:
        return repr({one.info.name: self._values[one.info.channel_id] for one in self._channels})


class Matched(ByChannel[Key, Item]):
    """One item and the nearest item of every other member: `matched[channel]` is an Item.

    `time` is the time of the item to which the others were matched. `missing` lists the members without an item within
    the tolerance.
    """

    def __init__(
        self, channels: Sequence[Key], values: Mapping[bytes, Item], *, missing: Sequence[Key], time: int
    ) -> None:
        super().__init__(channels, values)
        self.missing = tuple(missing)
        self.time = time


class NewestItems(ByChannel[Key, Item | None]):
    """The newest visible item of each channel, or None. `reasons[channel]` says why a channel has no such item.

    If the read has `as_of`, a channel with an item may have a reason, too: at that instant a later item may have been
    visible, and the archive may lack it.
    """

    def __init__(self, channels: Sequence[Key], answers: Mapping[bytes, Items], reason: Reason | None = None) -> None:
        """`answers`: for each channel an answer, newest item first. `reason`: why an earlier cut may be too low."""
        super().__init__(channels, {one: (items[0] if items else None) for one, items in answers.items()})
        reasons: dict[bytes, Reason] = {}
        for channel_id, items in answers.items():
            # An answer with an item matters here only if the earlier cut is uncertain.
            if items.reason is not None and (reason is not None or not items):
                reasons[channel_id] = items.reason
        self.reasons: ByChannel[Key, Reason] = ByChannel(channels, reasons)

    def with_handles(self, channels: Sequence[OtherKey]) -> NewestItems[OtherKey]:
        """See `ByChannel.with_handles`."""
        by_handle = super().with_handles(channels)
        newest = NewestItems(channels, {})  # the answers are gone, so this copies their items and reasons
        newest._channels, newest._values = by_handle._channels, by_handle._values
        newest.reasons = self.reasons.with_handles(channels)
        return newest


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupInfo:
    """A group as the directory knows it. If `reference_id` is None, the group has the smallest cut of its members.

    `bound`, `idle_after_nanos` and `max_lead_nanos` are settings of `Connection.group`. `created_by` is as in
    ChannelInfo. `spec_version` rises by 1 whenever the members or settings change.
    """

    group_id: bytes
    name: str
    channel_ids: Sequence[bytes]
    reference_id: bytes | None
    bound: str
    idle_after_nanos: int | None
    max_lead_nanos: int
    incarnation: int
    spec_version: int
    created_by: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class MemberStatus:
    """One member of a group, as the host that answers sees it.

    - `newest`: the time of the member's newest item; None if the member never had an item.
    - `advance`: the highest advance of the member; None if no producer has stated one.
    - `cut`: the member's own cut; None if the member never had an item or an advance.
    - `lead_nanos`: how far the member's newest item is ahead of the group's cut.
    - `hidden`: the number of the member's held items that the group does not show yet. It is None if the answering host
      does not own the member and so does not know the number.
    - `idle`: the group's cut does not wait for the member, because the member has been silent for `idle_after`.
    - `window_too_short`: retention collects the member's items before the group shows them.
    - `heard_ago_nanos`: the age of these facts; 0 for a member that the answering host owns.
    """

    newest: int | None
    advance: int | None
    cut: int | None
    lead_nanos: int | None
    hidden: int | None
    idle: bool
    window_too_short: bool
    heard_ago_nanos: int


@dataclass(frozen=True, kw_only=True)
class GroupStatus(Generic[Key]):
    """A group at one moment: its cut, the members that hold it back (`waiting_on`), and each member's status.

    `cut` is None while the group shows nothing. `host_time` is the clock of the host that answered.
    """

    cut: int | None
    waiting_on: Sequence[Key]
    members: ByChannel[Key, MemberStatus]
    host_time: int


@dataclass(frozen=True, kw_only=True)
class Cut(Generic[Key]):
    """A cut event: `cut[channel]` has the items of a channel that became visible since the event before.

    - `time`: the cut, exclusive.
    - `late[channel]`: items that are before the cut of an earlier event, and that the host accepted after that event.
    - `incomplete`: the members that had not reached the cut within `max_wait`.
    - `cut[channel].truncated`: some of the channel's items are missing in the event. `cut[channel].reason` says why.
    """

    time: int
    items: ByChannel[Key, Items]
    late: ByChannel[Key, Sequence[Item]]
    incomplete: Sequence[Key]

    def __getitem__(self, channel: NamedChannel | str) -> Items:
        return self.items[channel]

    def __iter__(self) -> Iterator[Key]:
        return iter(self.items)


@dataclass(frozen=True, kw_only=True)
class CrossSection(Generic[Key]):
    """One item of the reference, and the items of each other channel at that item: `section[channel]` is Items.

    `time` is the time of the reference's item. It is None if the reference had no item at the requested instant.
    `section[reference].reason` then says why.
    """

    time: int | None
    items: ByChannel[Key, Items]

    def __getitem__(self, channel: NamedChannel | str) -> Items:
        return self.items[channel]

    def __iter__(self) -> Iterator[Key]:
        return iter(self.items)


def parse_group_bound(bound: str) -> str:
    """Return `bound`. Raises InvalidArgument unless it is "start" or "end"."""
    if bound not in BOUNDS:
        raise InvalidArgument(f'bound is {bound!r}; write "start" or "end" (of a channel\'s newest item)')
    return bound


def parse_members(channels: Sequence[Key]) -> list[Key]:
    """Return the channels of a group as a list.

    Raises InvalidArgument unless there are 1 to MEMBERS_MAX channel handles, each of another channel.
    """
    if not isinstance(channels, Iterable) or isinstance(channels, str):
        raise InvalidArgument(f"channels is {channels!r}; give a list of channels, even for one")
    members = list(channels)
    for member in members:
        if not hasattr(member, "info"):
            raise InvalidArgument(
                f"{member!r} is not a channel; give the handle from connection.channel(...), not the name"
            )
    if not 1 <= len(members) <= MEMBERS_MAX:
        raise InvalidArgument(f"a group has 1 to {MEMBERS_MAX} channels, not {len(members)}")
    names = [member.info.name for member in members]
    doubled = {name for name in names if names.count(name) > 1}
    if doubled:
        raise InvalidArgument(f"{', '.join(sorted(doubled))} is in the list twice; name each channel once")
    return members


def parse_reference(reference: NamedChannel | str, members: Sequence[NamedChannel]) -> bytes | None:
    """Return the channel id of `reference`, which is the handle or name of a member. Returns None for "oldest".

    Raises InvalidArgument if `reference` is not a member.
    """
    if reference == OLDEST_REFERENCE:
        return None
    for member in members:
        if is_named_by(reference, member):
            return member.info.channel_id
    raise InvalidArgument(
        f'the reference {shown_name(reference)!r} is not a member of the group; name one of its channels, or "oldest"'
    )


def is_named_by(named: NamedChannel | str, channel: NamedChannel) -> bool:
    """Whether `named` names `channel`. `named` is a name, a handle or a descriptor."""
    if isinstance(named, str):
        return named == channel.info.name
    return getattr(named, "info", None) is not None and named.info.channel_id == channel.info.channel_id


def shown_name(named: NamedChannel | str) -> object:
    """Return the channel's name, for an error text. An object that is not a handle or name comes back as it is."""
    return named if isinstance(named, str) or not hasattr(named, "info") else named.info.name


def parse_tolerance(tolerance: DurationLike) -> int:
    """Return `tolerance` in nanoseconds. Raises InvalidArgument if it is negative or no duration."""
    nanos = parse_duration(tolerance, "tolerance")
    if nanos < 0:
        raise InvalidArgument(
            f'tolerance is {tolerance!r}; it is the greatest time between two matched items: give "0s" or more'
        )
    return nanos


def parse_lateness(lateness: DurationLike) -> int:
    """Return `lateness` in nanoseconds. Raises InvalidArgument if it is negative or no duration."""
    nanos = parse_duration(lateness, "lateness")
    if nanos < 0:
        raise InvalidArgument(f'lateness is {lateness!r}; it is a time to wait: give "0s" or more')
    return nanos


def parse_max_wait(max_wait: DurationLike) -> int:
    """Return `max_wait` in nanoseconds. Raises InvalidArgument if it is negative or no duration."""
    nanos = parse_duration(max_wait, "max_wait")
    if nanos < 0:
        raise InvalidArgument(f'max_wait is {max_wait!r}; it is a time to wait: give "0s" or more')
    return nanos
