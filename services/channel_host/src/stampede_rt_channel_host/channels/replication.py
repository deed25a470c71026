"""The replicas of one channel at its owner: their items, the items that readers see, and the acks that wait."""

from __future__ import annotations

import time
from collections.abc import Callable
from enum import Enum
from typing import Protocol

from stampede_rt.errors import Overloaded, StampedeError, Unavailable
from stampede_rt.values.model import Policy
from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.channels.owned_replicas import READY_SECONDS_MAX, OwnedReplicas, OwnersFeed
from stampede_rt_channel_host.core.channel import ITEM_OVERHEAD_BYTES, ChannelCore, NewItem, Pieces, ReplicatedView
from stampede_rt_channel_host.core.replication import ReplicasInSync, ReplicaState

UNSEEN_BYTES_MAX = 64 * 2**20
"""The most memory for items that have left the channel before its readers may see them."""


class ReplicaFeed(OwnersFeed, Protocol):
    """The feed of one replica."""

    def send_ahead(self, item: NewItem) -> None:
        """Send an item that the channel is about to store, if the replica lacks nothing else. Raises nothing."""


class ReplicationKind(Enum):
    """Whether a channel has replicas, and whether its puts wait for them."""

    NONE = "none"
    LAGGING = "lagging"  # puts do not wait for them, and readers see items immediately
    WAITED_FOR = "waited for"


def kind_of(policy: Policy) -> ReplicationKind:
    """Whether a channel with this policy has replicas, and whether its puts wait for them."""
    if policy.ack == "replica":
        return ReplicationKind.WAITED_FOR
    return ReplicationKind.LAGGING if policy.replicas else ReplicationKind.NONE


class Replication(OwnedReplicas[ReplicaFeed]):
    """The replicas of the channel `core`. `shown` is the channel as readers see it.

    If puts wait for replicas, `shown` has only replicated items. Otherwise it is `core`. Calls `on_shown` with the time
    after each change of `shown`.
    """

    is_filled = False
    """Whether `filling` has added all items."""

    def __init__(
        self, core: ChannelCore, now: Callable[[], int], on_shown: Callable[[int], None],
        steady_nanos: Callable[[], int] = time.monotonic_ns, *, epoch: int = 0, is_replicated: bool = False,
    ) -> None:  # fmt: skip
        """The caller must perform `filling` once. `epoch`: the epoch of the channel.

        `is_replicated`: the channel has moved here, and its former owner had all items replicated.
        """
        self.kind = kind_of(core.policy)
        may_lag, least = self.kind is ReplicationKind.LAGGING, _least(core.policy)
        in_sync = ReplicasInSync(core.next_seq, least, is_replicated=is_replicated, may_lag=may_lag)
        super().__init__(in_sync, epoch, steady_nanos)
        self._core = core
        self._now = now
        self._on_shown = on_shown
        self._view = None if may_lag else ReplicatedView(core, now(), slice_run)

    @property
    def shown(self) -> ChannelCore:
        """The channel as readers see it."""
        return self._core if self._view is None else self._view.shown

    @property
    def is_ready(self) -> bool:
        """Whether readers and producers may use the channel."""
        return self._view is None or (self.is_filled and self._in_sync.is_ready)

    @property
    def is_within_lag(self) -> bool:
        """Whether the replicas have all items that are older than a second."""
        return self._in_sync.within_lag(self._steady_nanos())

    @property
    def is_fully_replicated(self) -> bool:
        """Whether all items of the channel are replicated, so that it may move."""
        if self._view is None:
            return self._in_sync.is_fully_replicated
        return self.replicated_next == self._core.next_seq

    def check_movable(self) -> None:
        """Raises Unavailable if too few replicas are in sync: after a move the items would still not be replicated."""
        in_sync = sum(one is ReplicaState.IN for one in self.states().values())
        if self._view is not None and in_sync < self.min_replicas and not self.is_fully_replicated:
            name = self._core.name
            raise Unavailable(
                f"channel {name} needs {self.min_replicas} replicas in sync (min_replicas) and has {in_sync}, so some "
                f"of its items are at this host only; look at `stampede info {name}`, and move it later",
                metadata={"channel": name},
            )

    def own_again(self, epoch: int) -> None:
        """Note that this host is the owner again: the channel had moved away, and its new owner was lost."""
        self._in_sync.own_again()
        self.since_epoch = epoch

    def filling(self) -> Pieces[None]:
        """Add the items that the channel already has, in pieces."""
        if self._view is not None:
            yield from self._view.filling(self._now())
        self.is_filled = True
        self.accepted(self._now())
        self.wake_waits()

    async def ready(self) -> bool:
        """Wait until readers and producers may use the channel, READY_SECONDS_MAX at most. Returns whether they may."""
        return await self.wait_until(lambda: self.is_ready, READY_SECONDS_MAX)

    def configure(self, policy: Policy) -> None:
        """Take over another policy."""
        if self._view is not None:
            self._view.shown.configure(policy, self._now())
        self._in_sync.min_replicas = _least(policy)
        self.keeper_wakeup.set()

    def accepted(self, now: int) -> None:
        """Send a change of the channel to the replicas, and show the change as soon as it is replicated."""
        if not self.is_filled:
            return
        for feed in self._feeds.values():  # first: the replicas work while this host goes on
            feed.wake()
        if self._view is not None:
            self._view.stage(now)
        before = self.replicated_next
        self._in_sync.put(self._core.next_seq)
        if self._view is None:
            self._on_shown(now)
        if self.replicated_next != before:
            self.wake_waits()  # as in `release_replicated`
        self._show(now)

    @property
    def footprint_bytes(self) -> int:
        """The memory of the channel, without the memory of `core`: the index of items that readers see, and unseen
        items.
        """
        if self._view is None:
            return 0
        return self._view.shown.held.items * ITEM_OVERHEAD_BYTES + self._unseen_bytes

    @property
    def _unseen_bytes(self) -> int:
        """The memory of the items that have left `core`, and that readers will see as soon as they are replicated."""
        return 0 if self._view is None else max(0, self._view.staged_bytes - self._core.footprint_bytes)

    def check_room(self, _: int = 0) -> None:
        """Raises Overloaded if the replicas are so far behind that the channel takes no further items."""
        if self._unseen_bytes > UNSEEN_BYTES_MAX:
            name = self._core.name
            raise Overloaded(
                f"channel {name} takes no items now: {UNSEEN_BYTES_MAX} bytes of items have left it before its "
                f"replicas had them, and readers have not seen them; look at `stampede info {name}`, start another "
                "host, or put again later",
                metadata={"channel": name},
            )

    def collect(self, now: int) -> bool:
        """Free items that readers no longer see, and show which items have left. Returns True if more is left."""
        if self._view is None:
            return False
        self.accepted(now)
        return self._view.shown.collect(now)

    def add(self, host_id: bytes, feed: ReplicaFeed, error: StampedeError) -> None:
        """Note the feed of a replica. An earlier feed of the same replica ends with `error`."""
        former = self._feeds.get(host_id)
        self._feeds[host_id] = feed
        if former is not None:
            former.end(error)

    def receive_report(self, host_id: bytes, feed: ReplicaFeed, next_seq: int) -> None:
        """Take a report that came from the replica itself, like `report`. `next_seq` 0: it has not opened the feed.

        A replica that has opened the feed holds no item that this owner lacks, because the feed of a diverged replica
        begins anew.
        """
        if next_seq and self._feeds.get(host_id) is feed:
            self.diverged_host_ids.discard(host_id)
        self.report(host_id, feed, next_seq)

    def end(self, error: StampedeError) -> None:
        """End the feeds and the waits. The replicas come back if this host remains the owner."""
        for feed in [*self._feeds.values()]:
            feed.end(error)
        super().end(error)

    def send_ahead(self, item: NewItem) -> None:
        """Send the replicas a run that the channel is about to store."""
        for feed in self._feeds.values():
            feed.send_ahead(item)

    def close(self) -> None:
        """End the replication, because the host gives the channel up. Idempotent."""
        super().close()
        if self._view is not None:
            self._view.close()

    def release_replicated(self) -> None:
        """Show the replicated items to readers, and release the calls that wait for them."""
        self.wake_waits()  # first: no reader can ask before the change is shown, in the same turn of the event loop
        self._show(self._now())

    def _show(self, now: int) -> None:
        if self._view is not None and self.is_filled and self._view.show(self.replicated_next, now):
            self._on_shown(now)


def own_again(replication: Replication | None, former_epoch: int, epoch: int) -> None:
    """Note that a move has failed, and that this host is the owner in another epoch.

    If `epoch` does not follow `former_epoch`, another host was the owner meanwhile, even if this host never learned it.
    """
    if replication is not None and epoch > former_epoch + 1:
        replication.own_again(epoch)


def diverged_host_ids_of(replication: Replication | None) -> frozenset[bytes]:
    """The hosts of the replicas that must begin anew, see `OwnedReplicas`."""
    return frozenset() if replication is None else frozenset(replication.diverged_host_ids)


def _least(policy: Policy) -> int:
    return 1 if policy.min_replicas is None else policy.min_replicas
