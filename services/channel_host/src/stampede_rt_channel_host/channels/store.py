"""The channels of this host.

The store makes a channel when a caller first binds it. It serves no channel without the lease. It drops a channel that
was deleted or that another host owns.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from itertools import islice
from typing import Any

from sortedcontainers import SortedList

from stampede_rt.errors import ChannelNotFound, Overloaded, StampedeError
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.confirmed_records import confirmed_record
from stampede_rt_channel_host.channels.copy_state import Freshness
from stampede_rt_channel_host.channels.deletions import Deletions
from stampede_rt_channel_host.channels.frames import SharedDeliveries
from stampede_rt_channel_host.channels.host_clocks import HostClocks
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel, NewCopy
from stampede_rt_channel_host.channels.hosted_copies import HostedCopies, elsewhere
from stampede_rt_channel_host.channels.limits.creation_shares import CreationShares
from stampede_rt_channel_host.channels.limits.id_owners import IdOwners
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.channels.recordings import Recordings
from stampede_rt_channel_host.channels.rings import Rings
from stampede_rt_channel_host.channels.subscriptions.reader_drops import Readers
from stampede_rt_channel_host.channels.sweep import Sweep
from stampede_rt_channel_host.channels.time_limits import TimeLimits
from stampede_rt_channel_host.channels.totals import ChannelTotals
from stampede_rt_channel_host.cluster.directory import DirectoryQueries
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.single_flight import SingleFlight
from stampede_rt_channel_host.core.channel import ChannelCore, Pieces, batched_keys, one_after_another, rest_of
from stampede_rt_channel_host.core.records import PolicyChange, RecordedChannel
from stampede_rt_runtime.access.control import check_access, current_account, own_name
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.overload import RefusedCalls

logger = logging.getLogger(__name__)

CHANNELS_MAX = 100_000
CHANNELS_ENDED_PER_PIECE = 128
CHANNELS_COMPARED_PER_PIECE = 32  # to log and drop one takes up to 50 us
RECORDS_PER_PIECE = 64  # to decode a record takes 5 to 15 us
_ID_END = b"\xff" * 17  # above every id


class ChannelStore:
    """Every data request gets its channel by `find`. Before, a client calls `bind`. `bind` asks the directory if the
    store does not know the channel, or knows another epoch or an older spec than the caller.

    `lease_held` says whether the host may serve at this moment. `scheduler` does long work in pieces. `limits` ends
    the waits of all blocked gets. `consumers` remembers which caller uses which consumer id.
    """

    def __init__(
        self,
        identity: HostIdentity,
        directory: DirectoryQueries,
        clock: HostClock,
        *,
        lease_held: Callable[[], bool],
        memory: MemoryBudget,
        refused_calls: RefusedCalls | None = None,
    ) -> None:
        self.lease_held = lease_held
        self.scheduler = PieceScheduler()
        self.limits = TimeLimits(self.scheduler.begin)
        self.deliveries = SharedDeliveries()
        self._identity = identity
        self._directory = directory
        self._clocks = HostClocks(clock)
        self.now = self._clocks.now
        """The host's clock: nanoseconds since the Unix epoch, slewed, never stepping."""
        self._channels: dict[bytes, HostedChannel] = {}
        self._names: Any = SortedList()  # the name of each channel, with the channel's id
        self._single_flight = SingleFlight()
        self._deletions = Deletions()
        self._creation_shares = CreationShares(identity.name, "channels", CHANNELS_MAX)
        self._closing: StampedeError | None = None  # the error for all requests once the host shuts down
        self._registrations = 0  # the number of registrations whose answers have come
        self.memory = memory
        self.copies = HostedCopies(self._channels, self._add, self.forget)
        self.refused_calls = refused_calls or RefusedCalls()
        self.recordings = Recordings()
        self.sweep = Sweep(self.now)
        self.consumers = IdOwners()
        self.readers = Readers()
        self.departed = ChannelTotals()
        """The counters of the channels that this host served before."""
        self.rings = Rings(memory, self._clocks.read)

    def find(self, channel_id: bytes, epoch: int) -> HostedChannel:
        """The channel that this host owns, for one data request.

        Raises StaleBinding (NOT_HERE, WRONG_EPOCH), or Unavailable (SHUTTING_DOWN).
        """
        self._check_lease()
        hosted = self._channels.get(channel_id)
        if hosted is None or not hosted.epoch or hosted.copy is not None or hosted.is_heir:
            raise elsewhere(hosted) or refusals.not_here(self._identity.name, channel_id)
        if hosted.epoch != epoch:
            raise refusals.wrong_epoch(hosted.record.name, epoch, hosted.epoch)
        return hosted

    def find_readable(self, channel_id: bytes, epoch: int, demand: Freshness | None) -> HostedChannel:
        """The channel, or a copy of it that meets `demand`, for one read. None: only the owner will do.

        Raises the errors of `find`, and StaleBinding (MOVED) if the copy does not meet the demand.
        """
        copy = None if demand is None else self.copies.find(channel_id, epoch, demand)
        if copy is None:
            return self.find(channel_id, epoch)
        self._check_lease()
        return copy

    def find_any_epoch(self, channel_id: bytes) -> HostedChannel:
        """The channel, for a request without an epoch. Raises the errors of `find`."""
        hosted = self._channels.get(channel_id)
        if hosted is None or hosted.copy is None:
            return self.find(channel_id, hosted.epoch if hosted else 0)
        self._check_lease()
        return hosted

    def known(self, channel_id: bytes) -> HostedChannel | None:
        """The channel or copy, if it is here, whether it may be served or not."""
        return self._channels.get(channel_id)

    async def bind(self, channel_id: bytes, epoch: int, spec_version: int = 0) -> HostedChannel:
        """The channel under `epoch`. Asks the directory first if this host does not know the channel, or knows another
        epoch or an older spec.

        Raises StaleBinding (NOT_HERE, WRONG_EPOCH, MOVED), ChannelNotFound, Overloaded, Unavailable.
        """
        if not self._knows(channel_id, epoch, spec_version):
            async with self._single_flight.about(channel_id):
                if not self._knows(channel_id, epoch, spec_version):
                    await self._ask(channel_id)
        return self.find_readable(channel_id, epoch, Freshness())

    async def drop(self, channel_id: bytes, epoch: int, request_id: bytes, since_s: float) -> None:
        """Delete the channel in the directory and at this host. The streams of its readers end with CHANNEL_NOT_FOUND.

        Safe to repeat. `since_s`: when the caller made the request, in seconds of `request_age.age_clock_s`. Raises the
        errors of `bind`, and those that the directory answers.
        """
        if request_id in self._deletions:
            return
        await self.bind(channel_id, epoch)
        hosted = self.find(channel_id, epoch)  # not a copy
        check_access(AccessVerb.DELETE, AccessKind.CHANNEL, hosted.record.name)
        current_account().change()
        try:
            await self._directory.delete(channel_id, request_id=request_id, since_s=since_s)
        except ChannelNotFound:
            logger.info(
                "the channel is deleted already",
                extra={"event": "channel_already_deleted", "channel": hosted.record.name},
            )
        self._deletions.note(request_id, own_name())
        self.forget(channel_id, refusals.deleted(hosted.record.name))

    async def configure(
        self, channel_id: bytes, epoch: int, change: PolicyChange, request_id: bytes, since_s: float
    ) -> HostedChannel:
        """Change the policy in the directory, then at this host. Safe to repeat. `change`: the fields to change.

        Raises the errors of `bind`, InvalidArgument for a policy that no channel can have, and the errors that the
        directory answers.
        """
        await self.bind(channel_id, epoch)
        hosted = self.find(channel_id, epoch)  # not a copy
        check_access(AccessVerb.CONFIGURE, AccessKind.CHANNEL, hosted.record.name)
        current_account().change()
        self.recordings.check_change(hosted.record, change.stated)  # so that the directory takes no impossible policy
        registrations = self._registrations
        record = await self._directory.update(channel_id, epoch, change, request_id=request_id, since_s=since_s)
        if registrations != self._registrations:
            return await self.bind(channel_id, record.epoch, record.spec_version)
        return await self.recordings.adopt(record, hosted, self.adopt)

    def registering(self, records: Iterable[RecordedChannel], *, is_complete: bool) -> Pieces[None]:
        """Take in the directory's answer to a registration, in pieces. The host does not hold the lease meanwhile.

        The store drops the channels that went elsewhere, and takes over new epochs. `is_complete` False: the answer
        does not name all channels of the host. The store then serves an unnamed channel again only after its next
        `bind`.
        """
        self._registrations += 1
        registration = self._registrations
        listed: dict[bytes, RecordedChannel] = {}
        unread = iter(records)
        while part := [*islice(unread, RECORDS_PER_PIECE)]:
            listed.update((record.channel_id, record) for record in part)
            yield
        for names in batched_keys(self._names, CHANNELS_COMPARED_PER_PIECE):
            left: list[Pieces[None]] = []
            for _, channel_id in names:
                hosted = self._channels.get(channel_id)
                if hosted is not None and (hosted.copy or hosted.is_heir) and channel_id not in listed:
                    continue  # the directory lists only the channels that this host owns
                if hosted is not None and hosted.registration < registration:  # else a newer record has come meanwhile
                    self._compare(hosted, listed.get(channel_id), left, is_complete=is_complete)
            self.scheduler.begin(one_after_another(left))  # together, because each `begin` may start a task
            yield

    def _compare(
        self, hosted: HostedChannel, record: RecordedChannel | None, left: list[Pieces[None]], *, is_complete: bool
    ) -> None:
        """Adopt `record`, the directory's record of a channel that has not changed here since the registration.

        `record` None: the directory's answer does not name the channel. Then the store drops the channel, and adds the
        rest of that work to `left`. If the answer was not complete, the store asks the directory at the next `bind`
        instead.
        """
        if record is not None and not (record.policy.is_recorded and not hosted.has_same_items(record)):
            self.adopt(record)
        elif is_complete:
            logger.warning("channel went elsewhere", extra={"event": "channel_moved", "channel": hosted.record.name})
            error = refusals.not_here(self._identity.name, hosted.record.channel_id)
            left += self._drop(hosted.record.channel_id, error)
        else:
            hosted.epoch = 0  # `find` refuses it: the next bind asks the directory

    def fence(self) -> None:
        """End all waits and streams, because the lease has ended. The callers must look for the channels elsewhere."""
        self.end_all(refusals.fenced(self._identity.name))

    def close(self) -> None:
        """Refuse all requests from now on with SHUTTING_DOWN."""
        self._closing = refusals.SHUTTING_DOWN
        self.rings.fence()

    def end_all(self, error: StampedeError) -> None:
        """End the waits of all callers and the streams of all readers with `error`.

        If there are many of them, the last ones end a moment later.
        """
        self.scheduler.begin(self._ending(error))

    def _ending(self, error: StampedeError) -> Pieces[None]:
        for names in batched_keys(self._names, CHANNELS_ENDED_PER_PIECE):
            for _, channel_id in names:
                if (hosted := self._channels.get(channel_id)) is not None:  # if None, it has left meanwhile
                    yield from hosted.ending(error)
            yield

    def named_after(self, name: str, count: int) -> list[HostedChannel]:
        """The first `count` channels whose names follow `name`, sorted by name."""
        behind = self._names.irange(minimum=(name, _ID_END), inclusive=(False, True))
        return [self._channels[channel_id] for _, channel_id in islice(behind, count)]

    @property
    def count(self) -> int:
        """The number of channels that callers bound here."""
        return len(self._channels)

    def all(self) -> list[HostedChannel]:
        """All channels that callers bound here."""
        return list(self._channels.values())

    def _may_serve(self) -> bool:
        return self._closing is None and self.lease_held()

    def _check_lease(self) -> None:
        if self._closing is not None:
            raise self._closing
        if not self.lease_held():
            raise refusals.fenced(self._identity.name)

    def _knows(self, channel_id: bytes, epoch: int, spec_version: int) -> bool:
        hosted = self._channels.get(channel_id)
        if hosted is not None and hosted.copy is not None:
            return hosted.copy.is_ready and epoch <= hosted.epoch
        return hosted is not None and hosted.epoch == epoch and hosted.record.spec_version >= spec_version

    async def _ask(self, channel_id: bytes) -> None:
        self._check_lease()
        held = self._channels.get(channel_id)
        try:
            record = await confirmed_record(
                self._directory, channel_id, lambda: self._registrations, self._identity.name
            )
        except ChannelNotFound:
            if held is not None:
                self.forget(channel_id, refusals.deleted(held.record.name))
            raise
        if self._identity.host_id in record.copy_host_ids:
            return await self.copies.on_bound(record)
        if record.host_id != self._identity.host_id:
            error = refusals.moved(record.name, record.host_id)
            if held is None or not held.is_heir:
                self.forget(channel_id, error)
            raise elsewhere(held) or error
        await self.recordings.adopt(record, held, self.adopt)

    def adopt(self, record: RecordedChannel) -> HostedChannel:
        """Serve the channel according to a record of the directory. Ignores a record older than the present one."""
        held = self._channels.get(record.channel_id)
        if held is not None and held.copy is not None:  # this host has become the owner
            held = self.copies.inherit(held, record)
        if held is not None and held.record.incarnation == record.incarnation:
            if (record.epoch, record.spec_version) >= (held.record.epoch, held.record.spec_version):
                held.registration = self._registrations
                held.update(record)
            return held
        if held is not None:
            if record.epoch < held.record.epoch:
                return held
            self.forget(record.channel_id, refusals.wrong_epoch(record.name, held.record.epoch, record.epoch))
        return self._add(record)

    def _add(self, record: RecordedChannel, begun: NewCopy | ChannelCore | None = None) -> HostedChannel:
        if len(self._channels) >= CHANNELS_MAX:
            raise Overloaded(f"host {self._identity.name} has {CHANNELS_MAX} channels, the limit; use another host")
        self._creation_shares.check(record.created_by)
        hosted = HostedChannel(
            record,
            self.memory,
            self.now,
            self.sweep.touch,
            self._may_serve,
            self.scheduler.begin,
            self.limits,
            self.deliveries,
            begun,
        )
        hosted.registration = self._registrations
        self._channels[record.channel_id] = hosted
        self._names.add((record.name, record.channel_id))
        self._creation_shares.note(record.created_by, +1)
        return hosted

    def forget(self, channel_id: bytes, error: StampedeError) -> None:
        """Drop the channel, if it is here. Its callers get `error`."""
        self.scheduler.begin(one_after_another(self._drop(channel_id, error)))

    def _drop(self, channel_id: bytes, error: StampedeError) -> list[Pieces[None]]:
        """Drop the channel, and end the calls of some of its callers with `error`. Returns the rest of this work."""
        hosted = self._channels.pop(channel_id, None)
        if hosted is None:
            return []
        self.departed.add_counts(hosted, hosted.channel.latest_counters())
        self._names.remove((hosted.record.name, channel_id))
        self._creation_shares.note(hosted.record.created_by, -1)
        self.sweep.forget(hosted)
        return rest_of(hosted.leaving(error))
