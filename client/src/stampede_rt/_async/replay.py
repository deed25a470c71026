"""A replay under a virtual clock: a connection-like object that shows recorded channels as they were."""

from __future__ import annotations

import functools
from collections.abc import Awaitable, Callable, Sequence
from types import TracebackType
from typing import Any, Protocol, TypeVar

from stampede_rt._async.channel import Channel
from stampede_rt._async.cross_section import cross_section
from stampede_rt._async.group import Group
from stampede_rt._async.replayed_channel import ReplayedChannel
from stampede_rt._async.replayed_matches import ReplayedMatches
from stampede_rt._async.session import Session
from stampede_rt._async.virtual_clock import VirtualClock
from stampede_rt.errors import AheadOfClock, InvalidArgument
from stampede_rt.values.codecs import CodecLike
from stampede_rt.values.grouping import (
    ByChannel,
    CrossSection,
    NamedChannel,
    NewestItems,
    Over,
    is_named_by,
    parse_lateness,
    parse_tolerance,
    shown_name,
)
from stampede_rt.values.model import Items
from stampede_rt.values.policy import flag_of
from stampede_rt.values.timeline import NOW, BoundLike, DurationLike, parse_duration

Result = TypeVar("Result")


class Opener(Protocol):
    """A connection, which opens channels and groups."""

    async def channel(self, name: str, *, codec: CodecLike | None = None, create: bool = True) -> Channel:
        """See `Connection.channel`."""

    async def group(self, name: str) -> Group:
        """See `Connection.group`."""


class ReplayedConnection:
    """Recorded channels as they were, for programs that read them (see `Connection.replay`). A context manager.

    The clock moves only when the program waits: in a read with a timeout, in a step of a subscription or of matches, in
    `sleep`. Between two waits no virtual time passes. So a program with one thread gets the same answers in the same
    order in each replay, at any speed.
    """

    def __init__(self, opener: Opener, session: Session, start: int, end: int, speed: float, *, step: bool) -> None:
        self._connection = opener
        self._session = session
        self._end = end
        self._clock = VirtualClock(start, speed, step)
        session.attach(self._clock)

    def __repr__(self) -> str:
        return f"<ReplayedConnection at {self.now}>"

    async def __aenter__(self) -> ReplayedConnection:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the replay: waiting and later reads raise Unavailable. The connection stays open."""
        self._clock.close()
        self._session.detach(self._clock)

    @property
    def now(self) -> int:
        """The instant of the virtual clock, in nanoseconds since the epoch."""
        return self._clock.now

    async def sleep(self, duration: DurationLike) -> None:
        """Wait until the virtual clock is later by `duration`."""
        await self._clock.reach(self.now + parse_duration(duration, "duration"))

    def step(self, duration: DurationLike) -> int:
        """Move the clock of a replay with `step=True` forward by `duration`, and return its instant.

        The calls that wait for an instant up to then continue.
        """
        nanos = parse_duration(duration, "duration")
        if nanos < 0:
            raise InvalidArgument(f"duration is {duration!r}; a replay goes forward only")
        self._clock.move(self.now + nanos)
        return self.now

    async def channel(self, name: str, *, codec: CodecLike | None = None, **_: Any) -> ReplayedChannel:
        """Get a recorded channel. Ignores the arguments that say how to create one. Raises ChannelNotFound."""
        return self._replayed(await self._connection.channel(name, codec=codec, create=False))

    def _replayed(self, channel: Channel) -> ReplayedChannel:
        return ReplayedChannel(channel, self._clock, self._end)

    async def group(self, name: str, *_: object, **__: object) -> ReplayedGroup:
        """Get a group by its name, with its present members. Ignores the other arguments. Raises GroupNotFound."""
        group = await self._connection.group(name)
        return ReplayedGroup(group, [self._replayed(one) for one in group.channels], self._clock)

    async def cross_section(
        self,
        reference: ReplayedChannel,
        others: Sequence[ReplayedChannel],
        at: BoundLike = NOW,
        *,
        over: Over = "start",
        payloads: bool = True,
    ) -> CrossSection[ReplayedChannel]:
        """Return an item of `reference` with the items of `others` (see `Connection.cross_section`). Does not wait."""
        return await cross_section(reference, others, at, over=over, complete=False, payloads=payloads, timeout=0)


class ReplayedGroup:
    """A group under a virtual clock. It matches the items of its channels, and reads them up to the cut of the clock's
    instant. It has no descriptors and no cut events.
    """

    def __init__(self, group: Group, channels: Sequence[ReplayedChannel], clock: VirtualClock) -> None:
        self._group = group
        self.name = group.name
        self.channels = tuple(channels)
        """The members, in the order in which they joined."""
        self._clock = clock

    async def get(self, start: BoundLike, end: BoundLike, **how: Any) -> ByChannel[Channel, Items]:
        """Return for each member the items in an interval, at the cut of the clock's instant (see `Group.get`)."""
        read = functools.partial(self._group.get, start, end, **how)
        return await as_of_clock(lambda instant: read(as_of=instant), self._clock)

    async def newest(self, *, payloads: bool = True) -> NewestItems[Channel]:
        """Return the newest visible item of each member, at the cut of the clock's instant (see `Group.newest`)."""
        return await as_of_clock(lambda instant: self._group.newest(payloads=payloads, as_of=instant), self._clock)

    def match(
        self,
        per: NamedChannel | str,
        tolerance: DurationLike,
        *,
        lateness: DurationLike = "0s",
        partial: bool = False,
        payloads: bool = True,
        **_: Any,
    ) -> ReplayedMatches:
        """Match each new item of `per` (see `Group.match`), from the clock's instant on. Raises InvalidArgument."""
        if _.get("unique"):
            raise InvalidArgument("a replay does not match with unique=True; leave it out")
        if _.get("start") is not None:
            raise InvalidArgument("a replay matches from the instant of its clock on; leave start= out")
        found = next((one for one in self.channels if is_named_by(per, one)), None)
        if found is None:
            raise InvalidArgument(f"{shown_name(per)!r} is not a member of the group {self.name!r}")
        return ReplayedMatches(
            self._clock,
            self.channels,
            found,
            parse_tolerance(tolerance),
            parse_lateness(lateness),
            partial=flag_of("partial", partial),
            payloads=flag_of("payloads", payloads),
        )


async def as_of_clock(read: Callable[[int], Awaitable[Result]], clock: VirtualClock) -> Result:
    """Return the answer as of the clock's instant, or as of the host's clock if that is earlier."""
    try:
        return await read(clock.now)
    except AheadOfClock as error:  # a wait has moved the replay's clock ahead of the host's
        return await read(int(error.metadata["host_time_unix_nano"]))
