"""The channels and queues that a host owns, as its drain sees them."""

from __future__ import annotations

from typing import Protocol

from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.refusals import display_name


class OwnSubject(Protocol):
    """A channel or queue that this host owns."""

    id: bytes
    name: str
    request: pb.MoveHereRequest
    needs_archive: bool
    is_queue: bool

    @property
    def epoch(self) -> int:
        """Its present epoch."""

    @property
    def is_here(self) -> bool:
        """Whether this host still owns it. A move may succeed although its caller got no answer."""

    @property
    def is_moving(self) -> bool:
        """Whether the other host has begun the move."""

    @property
    def is_empty(self) -> bool:
        """Whether it has no item or message."""


class _OwnChannel:
    def __init__(self, store: ChannelStore, hosted: HostedChannel) -> None:
        self._store, self._hosted = store, hosted
        self.id, self.name = hosted.record.channel_id, hosted.record.name
        self.request = pb.MoveHereRequest(channel_id=self.id)
        self.needs_archive, self.is_queue = hosted.record.policy.is_recorded, False

    @property
    def epoch(self) -> int:
        return self._hosted.epoch

    @property
    def is_here(self) -> bool:
        return self._store.serves(self._hosted) and not self._hosted.is_fallback

    @property
    def is_moving(self) -> bool:
        return self._hosted.moving is not None

    @property
    def is_empty(self) -> bool:
        return self._hosted.core.latest_counters().held == 0


class _OwnQueue:
    def __init__(self, store: QueueStore, hosted: HostedQueue) -> None:
        self._store, self._hosted = store, hosted
        self.id, self.name = hosted.record.queue_id, f"queue {display_name(hosted.record)}"
        self.request = pb.MoveHereRequest(queue_id=self.id)
        self.needs_archive, self.is_queue = False, True

    @property
    def epoch(self) -> int:
        return self._hosted.epoch

    @property
    def is_here(self) -> bool:
        return self._store.serves(self._hosted)

    @property
    def is_moving(self) -> bool:
        return self._hosted.moving is not None or self._hosted.copying is not None

    @property
    def is_empty(self) -> bool:
        return self._hosted.queue.oldest_accepted_at is None


def owned_by(store: ChannelStore, queues: QueueStore) -> dict[bytes, OwnSubject]:
    """The channels and queues that this host owns, by id."""
    channels = (one for one in store.all() if one.copy is None and not one.is_fallback and one.epoch)
    own: list[OwnSubject] = [_OwnChannel(store, one) for one in channels]
    own += [_OwnQueue(queues, one) for one in queues.all() if one.epoch]
    return {one.id: one for one in own}
