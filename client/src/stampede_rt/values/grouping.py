"""Groups of channels as their readers hold them (paper, section 3.3). Pure.

Instants and durations are int nanoseconds. A cut is exclusive: items before it are visible.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, Protocol, TypeVar, get_args

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import ChannelInfo, Item, Items, Reason
from stampede_rt.values.timeline import DurationLike, parse_duration

MEMBERS_MAX = 64
GroupBound = Literal["start", "end"]
"""Where a channel's newest item is cut: at its time, or where its duration ends."""
Over = Literal["start", "span"]
"""What a cross-section is taken at: a moment, or all of an item's span."""
BOUNDS: tuple[GroupBound, ...] = get_args(GroupBound)
OLDEST_REFERENCE = "oldest"
MAX_LEAD_DEFAULT = "5s"

Value = TypeVar("Value")


class NamedChannel(Protocol):
    """A channel, or a descriptor of one."""

    @property
    def info(self) -> ChannelInfo:
        """What the directory says of it."""


Key = TypeVar("Key", bound=NamedChannel)


@dataclass(slots=True)
class SeenCut:
    """Through which group a reader looks, and the highest cut that it has seen, which no later read goes behind."""

    group_id: bytes
    cut_floor: int | None = None

    def saw(self, cut: int | None) -> None:
        """An answer came with this cut."""
        if cut is not None and (self.cut_floor is None or cut > self.cut_floor):
            self.cut_floor = cut


class ByChannel(Mapping[Key, Value], Generic[Key, Value]):
    """A value for each channel. Looked up by the channel's handle, by a group's descriptor of it, or by its name."""

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

    def __repr__(self) -> str:
        return repr({one.info.name: self._values[one.info.channel_id] for one in self._channels})


class Matched(ByChannel[Key, Item]):
    """One item and the nearest of every other member: `matched[channel]` is an Item.

    `time` is that of the item which the others were matched to; `missing` are members that have none within the
    tolerance.
    """

    def __init__(
        self, channels: Sequence[Key], values: Mapping[bytes, Item], *, missing: Sequence[Key], time: int
    ) -> None:
        super().__init__(channels, values)
        self.missing = tuple(missing)
        self.time = time


class NewestItems(ByChannel[Key, Item | None]):
    """The newest visible item of each channel, or None; `reasons[channel]` says why there is none."""

    def __init__(self, channels: Sequence[Key], answers: Mapping[bytes, Items]) -> None:
        """`answers`: of each channel what was asked for, its newest item first."""
        super().__init__(channels, {one: (items[0] if items else None) for one, items in answers.items()})
        told = {one: items.reason for one, items in answers.items() if not items and items.reason is not None}
        self.reasons: ByChannel[Key, Reason] = ByChannel(channels, told)


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupInfo:
    """A group as the directory knows it. `reference_id` None: the oldest of the members' cuts counts."""

    group_id: bytes
    name: str
    channel_ids: Sequence[bytes]
    reference_id: bytes | None
    bound: str
    idle_after_nanos: int | None
    max_lead_nanos: int
    incarnation: int
    spec_version: int


@dataclass(frozen=True, kw_only=True, slots=True)
class MemberStatus:
    """One member of a group, as the answering host sees it.

    `cut`: its own; None: it never had an item or an advance. `lead_nanos`: how far its newest item is ahead of the
    group's cut. `hidden`: held items that the cut hides; None if another host knows. `idle`: left out of the reference,
    since it has been silent for idle_after. `window_too_short`: retention takes its items before the group shows them.
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
    """A group at one moment: its cut (None: nothing is visible), who holds it back, and each member's place."""

    cut: int | None
    waiting_on: Sequence[Key]
    members: ByChannel[Key, MemberStatus]
    host_time: int


@dataclass(frozen=True, kw_only=True)
class Cut(Generic[Key]):
    """What a group made visible at once: for each channel the items since the cut before, `cut[channel]`.

    `time` is the cut, exclusive. `late[channel]`: items that were accepted below a cut that had been delivered already.
    `incomplete`: members that had not caught up when the wait for them was over. `cut[channel].truncated`: some items
    that were due are gone, and `.reason` says why.
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
    """What each channel holds at one item of the reference: `section[channel]`, Items.

    `time` is that item's; None if the reference holds nothing there, and its Items say why.
    """

    time: int | None
    items: ByChannel[Key, Items]

    def __getitem__(self, channel: NamedChannel | str) -> Items:
        return self.items[channel]

    def __iter__(self) -> Iterator[Key]:
        return iter(self.items)


def parse_group_bound(bound: str) -> str:
    """`bound` as it is. Raises InvalidArgument."""
    if bound not in BOUNDS:
        raise InvalidArgument(f'bound is {bound!r}; write "start" or "end" (where a channel\'s newest item is cut)')
    return bound


def parse_members(channels: Sequence[Key]) -> list[Key]:
    """The channels as they are. Raises InvalidArgument if there are none, too many, or one twice."""
    if not isinstance(channels, Iterable) or isinstance(channels, str):
        raise InvalidArgument(f"channels is {channels!r}; give a list of channels, even for one")
    members = list(channels)
    for member in members:
        if not hasattr(member, "info"):
            raise InvalidArgument(f"{member!r} is no channel; give what channel(...) gave, not its name")
    if not 1 <= len(members) <= MEMBERS_MAX:
        raise InvalidArgument(f"a group has 1 to {MEMBERS_MAX} channels, not {len(members)}")
    names = [member.info.name for member in members]
    doubled = {name for name in names if names.count(name) > 1}
    if doubled:
        raise InvalidArgument(f"{', '.join(sorted(doubled))} would be in the group twice; name each channel once")
    return members


def parse_reference(reference: NamedChannel | str, members: Sequence[NamedChannel]) -> bytes | None:
    """The id of the reference, one of the `members` by handle or name; None for "oldest". Raises InvalidArgument."""
    if reference == OLDEST_REFERENCE:
        return None
    for member in members:
        if is_named_by(reference, member):
            return member.info.channel_id
    raise InvalidArgument(
        f'the reference {shown_name(reference)!r} is no member of the group; name one of its channels, or "oldest"'
    )


def is_named_by(named: NamedChannel | str, channel: NamedChannel) -> bool:
    """It is the channel's name, or a handle or descriptor of it."""
    if isinstance(named, str):
        return named == channel.info.name
    return getattr(named, "info", None) is not None and named.info.channel_id == channel.info.channel_id


def shown_name(named: NamedChannel | str) -> object:
    """What to call it in an error."""
    return named if isinstance(named, str) or not hasattr(named, "info") else named.info.name


def parse_tolerance(tolerance: DurationLike) -> int:
    """Nanoseconds, 0 or more. Raises InvalidArgument."""
    nanos = parse_duration(tolerance, "tolerance")
    if nanos < 0:
        raise InvalidArgument(f"tolerance is {tolerance!r}; it is a distance of times: give 0 or more")
    return nanos


def parse_lateness(lateness: DurationLike) -> int:
    """Nanoseconds. Raises InvalidArgument."""
    nanos = parse_duration(lateness, "lateness")
    if nanos < 0:
        raise InvalidArgument(f'lateness is {lateness!r}; it is a time to wait: give "0s" or more')
    return nanos


def parse_max_wait(max_wait: DurationLike) -> int:
    """Nanoseconds, 0 or more. Raises InvalidArgument."""
    nanos = parse_duration(max_wait, "max_wait")
    if nanos < 0:
        raise InvalidArgument(f'max_wait is {max_wait!r}; it is a time to wait: give "0s" or more')
    return nanos
