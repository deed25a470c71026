# Generated from ../_async by tools/generate.py; do not edit.
"""A replay under a virtual clock: a connection-like object that shows recorded channels as they were."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, NoReturn, Protocol

from stampede_rt._sync.channel import Channel
from stampede_rt._sync.cross_section import cross_section
from stampede_rt._sync.group import Group
from stampede_rt._sync.replayed_channel import ReplayedChannel
from stampede_rt._sync.replayed_group import ReplayedGroup
from stampede_rt._sync.session import Session
from stampede_rt._sync.virtual_clock import VirtualClock
from stampede_rt.errors import ChannelNotFound, GroupNotFound, InvalidArgument
from stampede_rt.values.codecs import CodecLike
from stampede_rt.values.grouping import CrossSection, Over
from stampede_rt.values.replaying import not_replayed
from stampede_rt.values.timeline import NOW, BoundLike, DurationLike, InstantLike, parse_duration


class Opener(Protocol):
    """A connection, which opens channels and groups."""

    def channel(self, name: str, *, codec: CodecLike | None = None, create: bool = True) -> Channel:
        """See `Connection.channel`."""

    def group(self, name: str) -> Group:
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

    def __getattr__(self, name: str) -> NoReturn:
        raise not_replayed("Connection", name, self)

    def __repr__(self) -> str:
        return f"<ReplayedConnection at {self.now}>"

    def __enter__(self) -> ReplayedConnection:
        return self

    def __exit__(
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

    def sleep(self, duration: DurationLike) -> None:
        """Wait until the virtual clock is later by `duration`."""
        self._clock.reach(self.now + parse_duration(duration, "duration"))

    def step(self, duration: DurationLike) -> int:
        """Move the clock of a replay with `step=True` forward by `duration`, and return its instant.

        Calls that wait for this instant, or for an earlier one, then continue.
        """
        nanos = parse_duration(duration, "duration")
        if nanos < 0:
            raise InvalidArgument(f"duration is {duration!r}; a replay goes forward only")
        self._clock.move(self.now + nanos)
        return self.now

    def channel(self, name: str, *, codec: CodecLike | None = None, **stated: Any) -> ReplayedChannel:
        """Get a recorded channel. Ignores the arguments that say how to create one. Raises ChannelNotFound."""
        check_arguments(self._connection.channel, stated)
        try:
            return self._replayed(self._connection.channel(name, codec=codec, create=False))
        except ChannelNotFound as error:
            raise ChannelNotFound(f"there is no channel {name}, and a replay creates none") from error

    def _replayed(self, channel: Channel) -> ReplayedChannel:
        return ReplayedChannel(channel, self._clock, self._end)

    def group(self, name: str, channels: Sequence[object] | None = None, **stated: Any) -> ReplayedGroup:
        """Get a group by its name, with its present members. Ignores the other arguments. Raises GroupNotFound."""
        check_arguments(self._connection.group, stated)
        try:
            return ReplayedGroup(self._connection.group(name), self._clock, self._end)
        except GroupNotFound as error:
            raise GroupNotFound(f"there is no group {name}; create it through the connection, not a replay") from error

    def cross_section(
        self,
        reference: ReplayedChannel,
        others: Sequence[ReplayedChannel],
        at: BoundLike = NOW,
        *,
        over: Over = "start",
        complete: bool = False,
        payloads: bool = True,
        timeout: float | None = 0,
        as_of: InstantLike | None = None,
    ) -> CrossSection[ReplayedChannel]:
        """Return an item of `reference` with the items of `others` (see `Connection.cross_section`)."""
        began = self.now
        return cross_section(
            reference, others, at, over=over, complete=complete, payloads=payloads, timeout=timeout, as_of=as_of,
            clock_s=lambda: (self.now - began) / 1e9,
        )  # fmt: skip


def check_arguments(method: Callable[..., Any], stated: Mapping[str, Any]) -> None:
    """Raise TypeError for an argument that the method of the connection does not have."""
    unknown = next((one for one in stated if one not in inspect.signature(method).parameters), None)
    if unknown is not None:
        raise TypeError(f"{method.__name__}() got an unexpected keyword argument {unknown!r}")
