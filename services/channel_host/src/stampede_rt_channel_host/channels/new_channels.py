"""The beginnings of channels and copies at a host."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from stampede_rt.wire.run_slices import slice_run
from stampede_rt_channel_host.channels.copy_state import CopyState
from stampede_rt_channel_host.channels.replication import Replication
from stampede_rt_channel_host.core.channel import ChannelCore, Counters, FedChannel, Losses
from stampede_rt_channel_host.core.dedup import RetryWindow
from stampede_rt_channel_host.core.records import RecordedChannel, next_incarnation


class NewCopy(NamedTuple):
    """The beginning of a copy: its state, and the losses of the channel.

    `knows_owner`: the feed of the copy also has the facts that only the owner knows, so that the copy can become the
    owner. `channel`: the items with which the copy begins; None: it has none.
    """

    state: CopyState
    losses: Losses
    knows_owner: bool = False
    channel: FedChannel | None = None


class OwnedCore(NamedTuple):
    """The state of a channel at its owner: the items, and the retry window of the producers.

    `counted_before`: the counts of the former owners, which are in the sums of their hosts; None: there were none.
    `is_replicated`: all items are at all replicas in sync, if the channel has replicas. `diverged_host_ids`: see
    `OwnedReplicas`.
    """

    channel: ChannelCore
    retries: RetryWindow
    counted_before: Counters | None
    is_replicated: bool = False
    diverged_host_ids: frozenset[bytes] = frozenset()


def owned_core(copy: FedChannel, now: int, *, is_replicated: bool = False, incarnation: int | None = None) -> OwnedCore:
    """The channel that this copy becomes, see `FedChannel.as_owner`."""
    channel, retries = copy.as_owner(now, incarnation)
    return OwnedCore(channel, retries, channel.latest_counters(), is_replicated)


def core_of_replica(copy: FedChannel, held: RecordedChannel, record: RecordedChannel, now: int) -> OwnedCore | None:
    """The channel that a replica becomes as `record` says; None if the replica does not know enough.

    The directory makes the host of a copy the owner, in the same or the next incarnation, only if the copy is a replica
    in sync. It is the next incarnation if the former owner may have acknowledged items that the copy lacks. `held`: the
    record of the copy.
    """
    if copy.owner_facts is None:
        return None
    if copy.incarnation == record.incarnation:
        return owned_core(copy, now)
    if record.incarnation == next_incarnation(copy.incarnation) and record.epoch > held.epoch:
        return owned_core(copy, now, incarnation=record.incarnation)
    return None


def replication_of(
    core: ChannelCore, now: Callable[[], int], on_shown: Callable[[int], None], record: RecordedChannel,
    initial: NewCopy | OwnedCore | None,
) -> Replication:  # fmt: skip
    """The replicas of a channel that begins at its owner."""
    is_replicated = isinstance(initial, OwnedCore) and initial.is_replicated
    replication = Replication(core, now, on_shown, epoch=record.epoch, is_replicated=is_replicated)
    if isinstance(initial, OwnedCore):
        replication.diverged_host_ids.update(initial.diverged_host_ids)
    return replication


def new_core(record: RecordedChannel, now: int, copy: NewCopy | OwnedCore | None) -> ChannelCore:
    """The items that `copy` has, or an empty channel or copy.

    An empty channel counts the items of earlier owners as lost, if there may have been some.
    """
    if copy is not None and copy.channel is not None:
        return copy.channel
    incarnation, name = record.incarnation, record.name
    if copy is None:
        lost_before = now if record.may_have_lost else None
        return ChannelCore(record.policy, incarnation=incarnation, name=name, lost_before=lost_before, cut=slice_run)
    assert isinstance(copy, NewCopy), "an owned core has a channel"
    fed = FedChannel(record.policy, incarnation=incarnation, name=name, cut=slice_run, knows_owner=copy.knows_owner)
    fed.take_losses(copy.losses)
    return fed
