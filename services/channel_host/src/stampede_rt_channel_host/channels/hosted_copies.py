"""The copies of other hosts' channels at this host. The store's table has them, and also the host's own channels."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.copy_state import CopyState, Freshness, gone
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.new_channels import NewCopy, OwnedCore, owned_core
from stampede_rt_channel_host.channels.replication import diverged_host_ids_of, kind_of
from stampede_rt_channel_host.core.channel import FedChannel
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_channel_host.core.records import RecordedChannel


class HostedCopies:
    """Begins and drops copies. `channels` is the table of the store, `add` and `forget` change it.

    The store calls `on_bound` if a caller binds a channel of which the directory has a copy at this host. `on_bound`
    begins the copy, and waits until the copy can serve readers.
    """

    def __init__(
        self, channels: Mapping[bytes, HostedChannel],
        add: Callable[[RecordedChannel, NewCopy | OwnedCore], HostedChannel],
        forget: Callable[[bytes, StampedeError], None],
    ) -> None:  # fmt: skip
        self._channels = channels
        self._add = add
        self._forget = forget
        self.on_bound: Callable[[RecordedChannel], Awaitable[None]] = _refuse
        self.on_inherited: Callable[[Sequence[CutFloor]], None] = _ignore_floors  # gets the cuts that the copy knew

    def of(self, channel_id: bytes) -> HostedChannel | None:
        """The copy of the channel; None if there is none."""
        hosted = self._channels.get(channel_id)
        return None if hosted is None or hosted.copy is None else hosted

    def find(self, channel_id: bytes, epoch: int, demand: Freshness) -> HostedChannel | None:
        """The copy; None if there is none. Raises StaleBinding (MOVED) if the copy does not meet the demand.

        A copy also serves readers that know an earlier epoch, so that they need not ask the directory after each move.
        """
        hosted = self.of(channel_id)
        if hosted is None or hosted.copy is None:
            return None
        if epoch > hosted.epoch:
            raise refusals.copy_cannot(hosted.record.name, f"is at epoch {hosted.epoch}, and the request at {epoch}")
        hosted.copy.check(hosted.record.name, hosted.channel.next_seq, demand)
        return hosted

    def begin(self, record: RecordedChannel, initial: NewCopy) -> HostedChannel:
        """Make an empty copy of the channel. Drops a former copy; the readers of the former copy get MOVED.

        Raises Overloaded if the host has too many channels.
        """
        on_dropped, initial.state.on_dropped = initial.state.on_dropped, _nothing  # the feed stays the same
        self._forget(record.channel_id, gone(record.name))
        initial.state.on_dropped = on_dropped
        return self._add(record, initial)

    def inherit(self, copy: HostedChannel, record: RecordedChannel) -> HostedChannel | None:
        """Make a copy the owner, as `record` of the directory says. Returns the owner; None if the copy cannot become
        the owner.

        Drops the copy; its readers get MOVED, and come back to the owner. The owner holds puts until the move is over.
        """
        inheritance = copy.copy.may_inherit if copy.copy is not None else None
        if copy.copy is None or inheritance is None or not inherits(copy, record):
            self._forget(record.channel_id, gone(record.name))
            return None
        assert isinstance(copy.channel, FedChannel), "it is a copy"
        core = owned_core(copy.channel, inheritance.host_time, is_replicated=True)
        copy.is_inherited = True
        self._forget(record.channel_id, gone(record.name))
        owner = self._add(record, core)
        owner.begin_move().hold()
        self.on_inherited([*copy.copy.floors.values()])
        return owner

    def demote(self, owner: HostedChannel, record: RecordedChannel, state: CopyState, now: int) -> None:
        """Turn a former owner into a replica. It replaces the replica that has become the owner. The callers of the
        former owner get MOVED.
        """
        channel = FedChannel.of_owner(owner.core, owner.puts.retries, now)
        owner.is_inherited = True
        self._forget(record.channel_id, gone(record.name))
        self._add(record, NewCopy(state, channel.losses, knows_owner=True, channel=channel))

    def drop(self, channel_id: bytes, error: StampedeError) -> None:
        """Drop the copy of the channel, if there is one. Its readers get `error`."""
        if self.of(channel_id) is not None:
            self._forget(channel_id, error)


def refusal_of(hosted: HostedChannel, demand: Freshness | None) -> StampedeError | None:
    """The error for a read that waited at a copy, if the copy no longer meets the read's demand; otherwise None."""
    try:
        if hosted.copy is not None:
            hosted.copy.check(hosted.record.name, hosted.channel.next_seq, demand or Freshness())
    except StampedeError as error:
        return error
    return None


def inherits(copy: HostedChannel, record: RecordedChannel) -> bool:
    """Whether `record` makes this host the owner by a move, and the copy has everything that the owner had."""
    fits = record.incarnation == copy.record.incarnation and record.epoch == copy.record.epoch + 1
    return fits and copy.copy is not None and copy.copy.may_inherit is not None


def is_left_to_move(hosted: HostedChannel | None) -> bool:
    """Whether the directory may soon commit a move of the channel, or has done so. Then only that move decides about
    the items.
    """
    if hosted is not None and hosted.copy is not None:
        return hosted.copy.moves_here
    return hosted is not None and hosted.moving is not None and hosted.moving.is_held


def changes_kind(hosted: HostedChannel, record: RecordedChannel) -> bool:
    """Whether the owner must serve the channel with another kind of replicas from now on, or without."""
    return hosted.copy is None and kind_of(record.policy) is not hosted.kind_of_replicas


def is_undecided(hosted: HostedChannel, record: RecordedChannel) -> bool:
    """Whether a move that is under way must be decided before this host serves the channel in the way of `record`.

    A new object for the channel would not know the move, and would accept puts that the next owner does not get.
    """
    return hosted.moving is not None and hosted.moving.is_held and record.epoch <= hosted.record.epoch


def ignores(hosted: HostedChannel, record: RecordedChannel) -> bool:
    """Whether the host goes on with the channel as it is: it knows a later record than `record`, or it serves the
    channel with another kind of replicas only after a move. `bind` raises an error until then.
    """
    is_older = (record.epoch, record.spec_version) < (hosted.record.epoch, hosted.record.spec_version)
    return is_older or (changes_kind(hosted, record) and is_undecided(hosted, record))


def check_policy(hosted: HostedChannel | None, spec_version: int) -> None:
    """Raises Unavailable if the channel gets the policy with this version only after a move."""
    if hosted is not None and hosted.record.spec_version < spec_version and is_undecided(hosted, hosted.record):
        raise refusals.policy_after_move(hosted.record.name)


def continued_core(hosted: HostedChannel) -> OwnedCore:
    """The items with which the owner continues in another way: with replicas or without."""
    diverged = diverged_host_ids_of(hosted.replication)
    return OwnedCore(hosted.core, hosted.puts.retries, hosted.counted_before, diverged_host_ids=diverged)


def redirect_error(hosted: HostedChannel | None) -> StampedeError | None:
    """The error that sends callers to the new owner of a channel that has just moved from here; otherwise None."""
    return hosted.moving.redirect_error if hosted is not None and hosted.moving is not None else None


def _ignore_floors(floors: Sequence[CutFloor]) -> None:
    """Does nothing: the host knows no groups."""


def _nothing() -> None:
    """Do nothing, because the feed of the copy continues."""


async def _refuse(record: RecordedChannel) -> None:
    """Refuse to begin a copy. The host replaces this function by its own."""
    raise refusals.copy_cannot(record.name, "does not exist")
