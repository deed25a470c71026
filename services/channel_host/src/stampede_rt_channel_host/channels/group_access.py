"""The interface through which streams of channels use the host's groups.

Groups are built on channels, not the reverse.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.observers import ChangeObserver
from stampede_rt_channel_host.channels.past_reads import PastSummary
from stampede_rt_channel_host.channels.recording import Recording
from stampede_rt_channel_host.core.channel import Query, ReadAnswer, SavedCursor, SubscriptionBatch


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupReadParams:
    """The group through which a get reads.

    `floor`: the highest cut that the reader has seen; None: the reader has seen no cut. `at`: the cut at which the get
    reads; None: the present cut. `within_memory`: the get leaves the archive of the channel out. `as_of`: the get
    answers as at this instant, at the cut `at`.
    """

    group_id: bytes
    floor: int | None = None
    at: int | None = None
    within_memory: bool = False
    as_of: int | None = None


class GroupAnswer(NamedTuple):
    """The answer to a get, and the cut at which the get read the channel; None: the group had no cut yet.

    `continues`: the answer was cut off for its length. `past`: the facts for a get as of an earlier instant.
    """

    answer: ReadAnswer
    cut: int | None
    continues: bool = False
    past: PastSummary | None = None


class Cursor(Protocol):
    """The place at which a subscription stands. Each mode of subscriptions has its own cursor."""

    def take(self, now: int, limit_bytes: int) -> SubscriptionBatch:
        """Take the next items, about `limit_bytes` bytes. Returns an empty batch if there are no new items."""

    async def from_archive(
        self, recording: Recording, limit_bytes: int, now: Callable[[], int]
    ) -> SubscriptionBatch | None:
        """Take the next items from the archive if memory no longer has them; otherwise None. Raises Unavailable."""

    def is_held(self, now: int) -> bool:
        """Whether memory has the next items. False if an archive may have some of them."""

    def progress(self, now: int) -> pb.SubscriptionProgress:
        """The progress of the subscription, as the reader gets it."""

    @property
    def skipped(self) -> int:
        """The number of items that the subscription passed over, as of the last `take`."""

    @property
    def saved(self) -> SavedCursor | None:
        """The place from which a later subscription of the reader continues.

        None while a subscription through a group has sent only a part of the items between two cuts. If the stream
        breaks then, the reader continues from the last saved place, and gets some items again.
        """


class GroupAccess(Protocol):
    """Reads and subscriptions through a group.

    All methods raise InvalidArgument if the group does not have the channel, and IncarnationLost if the request has a
    position of another incarnation. `read` and `subscribe` raise GROUP_NOT_FOUND, too.
    """

    def read_now(
        self,
        params: GroupReadParams,
        hosted: HostedChannel,
        query: Query,
        wait_nanos: int,
        now: int,
        check: Callable[[str], None],
    ) -> GroupAnswer | None:
        """The answer, if the group has the answer at this moment. If None, call `read`, which may wait.

        The method calls `check` with the group's name. `check` raises PermissionDenied if the reader may not read
        through the group.
        """

    async def read(
        self,
        params: GroupReadParams,
        hosted: HostedChannel,
        query: Query,
        wait_nanos: int,
        check: Callable[[str], None],
    ) -> GroupAnswer:
        """Wait for the answer, at most `wait_nanos` nanoseconds; below 0: without limit. `check`: see `read_now`.

        If the reader has already seen a cut that this host has not reached, the wait for this cut may be a little
        longer than `wait_nanos`.
        """

    def subscribe(
        self, opening: pb.SubscribeOpen, hosted: HostedChannel, observer: ChangeObserver
    ) -> AbstractAsyncContextManager[Cursor]:
        """A context that holds a subscription. Inside it, the host wakes `observer` when the group shows more."""
