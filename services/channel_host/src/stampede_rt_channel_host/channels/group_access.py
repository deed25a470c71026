"""How the streams of channels reach the groups of the host, which are built on channels."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.observers import ChannelObserver
from stampede_rt_channel_host.core.channel import Query, ReadAnswer, SavedCursor, SubscriptionBatch


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupAsk:
    """Through which group a get reads. `floor`: the highest cut that the reader has seen; `at`: the cut to read at."""

    group_id: bytes
    floor: int | None = None
    at: int | None = None


class GroupAnswer(NamedTuple):
    """An answer, and the cut that was used."""

    answer: ReadAnswer
    cut: int | None


class Cursor(Protocol):
    """Where a subscription stands; what differs between its modes."""

    def take(self, now: int, limit_bytes: int) -> SubscriptionBatch:
        """The next part, about `limit_bytes`; empty if there is nothing new."""

    def progress(self, now: int) -> pb.SubscriptionProgress:
        """How far the subscription is."""

    @property
    def skipped(self) -> int:
        """Items that were passed over, as of the last part."""

    @property
    def saved(self) -> SavedCursor | None:
        """From where another goes on; None: from the one before this one, and what came since comes again."""


class GroupAccess(Protocol):
    """Reads and subscriptions through a group. All raise GROUP_NOT_FOUND, INVALID_ARGUMENT, IncarnationLost."""

    def read_now(
        self, ask: GroupAsk, hosted: HostedChannel, query: Query, wait_nanos: int, now: int
    ) -> GroupAnswer | None:
        """The answer, if there is one at this moment; None: call `read`, which may have to wait."""

    async def read(self, ask: GroupAsk, hosted: HostedChannel, query: Query, wait_nanos: int) -> GroupAnswer:
        """Block until there is an answer, for `wait_nanos` beside what the cut takes; below 0: without limit."""

    def subscribe(
        self, begun: pb.SubscribeOpen, hosted: HostedChannel, listener: ChannelObserver
    ) -> AbstractAsyncContextManager[Cursor]:
        """Where a subscription begins; as long as it is entered, `listener` hears of changes of the group."""
