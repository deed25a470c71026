"""One stream between two hosts that share a group: the times of channels, and the cuts (paper, section 4.1).

Both sides do the same. A side sends a change without delay, unless it is still writing its last message, or finished
that write less than PACE_SECONDS ago. In these cases it first collects changes. Then it sends the latest state of the
changed channels and groups, up to ENTRIES_MAX of each in one message. So busy channels cost a bounded number of
messages.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Collection
from typing import Any, Protocol

from stampede_rt.errors import InvalidArgument, PermissionDenied, Unavailable, VersionMismatch
from stampede_rt.v1 import group_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.cluster.cut_floors import floor_to_message
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_runtime.version import PROTOCOL_VERSION

PACE_SECONDS = 0.005
LINK_SIGN_OF_LIFE_SECONDS = 1.0  # a link without changes sends a sign of life this often
BROKEN_AFTER_SECONDS = 5.0  # a link ends after this silence of the other host
ENTRIES_MAX = 1024  # the most channels, and the most groups, in one message
INTEREST_MAX = 4096  # the most channels of which one host may want to receive


class LinkHandler(Protocol):
    """The source of a link's messages, and the receiver of the other host's messages."""

    def times_of(self, channel_id: bytes) -> group_pb2.ChannelTimes | None:
        """The times of a channel of this host; None if this host does not own it."""

    def floor_of(self, group_id: bytes) -> CutFloor | None:
        """The group's cut at this host; None: no item is visible, or the host does not know the group."""

    def receive(self, host_id: bytes, update: pb.TimesUpdate, *, is_first: bool) -> None:
        """Process an update of the other host.

        `is_first`: with this update, the other host has sent its whole state for the first time.
        """

    def name_of_host(self, host_id: bytes) -> str:
        """The name that the directory has for a host of a group known here; empty for any other host."""

    def greeted(self, link: HostLink) -> None:
        """Note that the other host has sent its id."""

    def channels_requested(self, channel_ids: set[bytes]) -> None:
        """Note that the other host wants to receive of these channels, which it believes to be at this host."""

    def check_lease(self) -> None:
        """Raises HostNotFound if this host may not report on its channels."""


class HostLink:
    """One link. `write` and `read` are the methods of the gRPC call, whichever side has made the call.

    `message` makes the messages that this side sends.
    """

    def __init__(
        self,
        identity: HostIdentity,
        cluster_id: str,
        handler: LinkHandler,
        message: Callable[..., Any],
        write: Callable[[Any], Awaitable[None]],
        read: Callable[[], Awaitable[Any]],
        certified_name: str = "",
    ) -> None:
        """`certified_name` is the name in the caller's certificate; empty without one, or if this side has made the
        call.
        """
        self.host_id = b""  # the other host's id; empty until that host has sent its hello
        self._identity = identity
        self._cluster_id = cluster_id
        self._handler = handler
        self._message, self._write, self._read = message, write, read
        self._certified_name = certified_name
        self._has_full_state = False  # whether the other side has sent its whole state by now
        self._wanted: set[bytes] = set()  # channels of this host that the other host wants to receive of
        self._times: dict[bytes, None] = {}  # channels whose times this side has still to send
        self._floors: dict[bytes, None] = {}  # groups whose cut this side has still to send
        self._interest: Collection[bytes] | None = None  # the argument of `want`, until it is sent
        self._wakeup = asyncio.Event()

    async def run(self, other_id: bytes | None = None) -> None:
        """Serve until the other side ends the stream or is silent too long.

        `other_id` is the id that the other host must have; None: it may be any host. Raises the error that broke the
        stream. After both hellos this error comes in an exception group.
        """
        hello = pb.ExchangeHello(
            cluster_id=self._cluster_id,
            host_id=self._identity.host_id,
            boot_incarnation=self._identity.boot_incarnation,
            protocol_version=PROTOCOL_VERSION,
        )
        await self._write(self._message(hello=hello))
        self._greet(await self._next(), other_id)
        self._handler.greeted(self)
        async with asyncio.TaskGroup() as sides:
            writing = sides.create_task(self._write_all())
            await self._read_all()
            writing.cancel()

    def want(self, channel_ids: Collection[bytes]) -> None:
        """Set the other host's channels of which this host wants to receive, at most INTEREST_MAX.

        The link looks at `channel_ids` when it sends them, so later changes before that time count, too.
        """
        self._interest = channel_ids
        self._wakeup.set()

    def report_times(self, channel_id: bytes) -> None:
        """Send the times of a channel of this host soon, if the other host wants to receive of the channel."""
        if channel_id in self._wanted:
            self._times[channel_id] = None
            self._wakeup.set()

    def report_floor(self, group_id: bytes) -> None:
        """Send this host's cut of a group soon. Both hosts have members in the group."""
        self._floors[group_id] = None
        self._wakeup.set()

    def _greet(self, message: Any, other_id: bytes | None) -> None:
        hello = message.hello if message is not None and message.HasField("hello") else None
        if hello is None:
            raise InvalidArgument("the first message of an exchange has no hello; send it first, in its own message")
        if hello.protocol_version != PROTOCOL_VERSION:
            raise VersionMismatch(
                f"the other host speaks protocol {hello.protocol_version}, this one {PROTOCOL_VERSION}; install the "
                "same release on both"
            )
        if self._cluster_id and hello.cluster_id and hello.cluster_id != self._cluster_id:
            raise InvalidArgument(f"the hello is of cluster {hello.cluster_id}, and this is {self._cluster_id}")
        if other_id is not None and hello.host_id != other_id:
            raise InvalidArgument(
                f"host {hello.host_id.hex()} answers at the address of host {other_id.hex()}; resolve that host again"
            )
        if len(hello.host_id) != ID_BYTES:
            raise InvalidArgument(f"the hello has a host_id of {len(hello.host_id)} bytes; ids have {ID_BYTES}")
        self._check_name(hello.host_id)
        self.host_id = hello.host_id

    def _check_name(self, host_id: bytes) -> None:
        """Check that the certificate's name is the name of the host. Raises PermissionDenied."""
        name = self._handler.name_of_host(host_id)
        if self._certified_name and name and name != self._certified_name:
            raise PermissionDenied(
                f"the certificate belongs to host {self._certified_name}, but the hello names host {name}; a host "
                "speaks only for itself"
            )

    async def _next(self) -> Any:
        """The next message; None if the other side has ended the stream."""
        try:
            async with asyncio.timeout(BROKEN_AFTER_SECONDS):
                message = await self._read()
        except TimeoutError:
            raise Unavailable(f"the other host was silent for {BROKEN_AFTER_SECONDS:g} s") from None
        return message if hasattr(message, "HasField") else None  # gRPC's EOF has no fields

    async def _read_all(self) -> None:
        while (message := await self._next()) is not None:
            update = message.update
            if update.HasField("interest"):
                self._wanted = set(update.interest.channel_ids[:INTEREST_MAX])
                self._handler.channels_requested(self._wanted)
                self._times.update(dict.fromkeys(sorted(self._wanted)))
                self._wakeup.set()
            first = not self._has_full_state and len(update.floors) < ENTRIES_MAX
            self._has_full_state = self._has_full_state or first
            self._check_name(self.host_id)  # the host and its name may have become known since the hello
            self._handler.receive(self.host_id, update, is_first=first)

    async def _write_all(self) -> None:
        while True:  # until `run` cancels this task, or an error ends it
            await self._write(self._message(update=self._gather()))
            await asyncio.sleep(PACE_SECONDS)
            if not (self._times or self._floors):
                await self._wait()

    async def _wait(self) -> None:
        try:
            async with asyncio.timeout(LINK_SIGN_OF_LIFE_SECONDS):
                await self._wakeup.wait()
        except TimeoutError:
            return

    def _gather(self) -> pb.TimesUpdate:
        """Take the changes that wait, up to ENTRIES_MAX of each kind, and return their latest state.

        If nothing has changed, the update is empty: a sign of life.
        """
        self._handler.check_lease()
        self._wakeup.clear()
        interest, self._interest = self._interest, None
        times = [self._handler.times_of(one) for one in _taken(self._times)]
        floors = [self._handler.floor_of(one) for one in _taken(self._floors)]
        return pb.TimesUpdate(
            interest=None if interest is None else pb.TimesInterest(channel_ids=sorted(interest)),
            times=[one for one in times if one is not None],
            floors=[floor_to_message(one) for one in floors if one is not None],
        )


def _taken(waiting: dict[bytes, None]) -> list[bytes]:
    taken = list(waiting)[:ENTRIES_MAX]
    for one in taken:
        del waiting[one]
    return taken
