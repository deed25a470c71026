"""The channels of this host.

The store makes a channel when a caller first binds it. It serves no channel without the lease. It drops a channel that
was deleted or that another host owns.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from functools import partial

from stampede_rt.errors import ChannelNotFound, StampedeError
from stampede_rt_channel_host.channels import hosted_copies, refusals
from stampede_rt_channel_host.channels.channel_table import ChannelTable, comparing
from stampede_rt_channel_host.channels.confirmed_records import confirmed_record
from stampede_rt_channel_host.channels.copy_state import Freshness, gone
from stampede_rt_channel_host.channels.frames import SharedDeliveries
from stampede_rt_channel_host.channels.host_clocks import HostClocks
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.hosted_copies import HostedCopies, inherits, is_left_to_move, redirect_error
from stampede_rt_channel_host.channels.limits.caller_ids import CallerIds
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.multicast.multicasts import Multicasts
from stampede_rt_channel_host.channels.new_channels import NewCopy, OwnedCore
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
from stampede_rt_channel_host.core.channel import Pieces, one_after_another, rest_of
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.overload import RefusedCalls

logger = logging.getLogger(__name__)

CHANNELS_ENDED_PER_PIECE = 128


class ChannelStore:
    """Every data request gets its channel by `find`. Before that, a client calls `bind`. `bind` asks the directory if
    the store does not know the channel, or knows another epoch or an older spec than the caller.

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
        self._channels = ChannelTable(identity.name)
        self._single_flight = SingleFlight()
        self._closing: StampedeError | None = None  # the error for all requests as soon as the host shuts down
        self.version_of = self._channels.version_of
        """See `ChannelTable`."""
        self.memory = memory
        self.copies = HostedCopies(self._channels, self._add, self.forget)
        self.refused_calls = refused_calls or RefusedCalls()
        self.recordings = Recordings()
        self.sweep = Sweep(self.now)
        self.consumers = CallerIds()
        self.readers = Readers()
        self.departed = ChannelTotals()
        """The counters of the channels that this host served before."""
        self.rings = Rings(memory, self._clocks.read)
        self.multicasts: Multicasts | None = None
        """The channels that the host multicasts; None: it multicasts none."""
        self.on_replicated: Callable[[HostedChannel], None] = lambda hosted: None
        """Called with each channel that this host owns and that has replicas."""

    def find(self, channel_id: bytes, epoch: int) -> HostedChannel:
        """The channel that this host owns, for one data request.

        Raises StaleBinding (NOT_HERE, WRONG_EPOCH), or Unavailable (SHUTTING_DOWN).
        """
        self._check_lease()
        hosted = self._channels.get(channel_id)
        if hosted is None or not hosted.epoch or hosted.copy is not None or hosted.is_fallback or not hosted.is_ready:
            raise redirect_error(hosted) or refusals.not_here(self._identity.name, channel_id)
        if hosted.epoch != epoch:
            raise refusals.wrong_epoch(hosted.record.name, epoch, hosted.epoch)
        return hosted

    def serves(self, hosted: HostedChannel) -> bool:
        """Whether this object still serves its channel at this host."""
        return self._channels.get(hosted.record.channel_id) is hosted

    def find_readable(self, channel_id: bytes, epoch: int, demand: Freshness | None) -> HostedChannel:
        """The channel, or a copy of it that meets `demand`, for one read.

        `demand` None: only the owner may serve the read. Raises the errors of `find`, and StaleBinding (MOVED) if the
        copy does not meet the demand.
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
        epoch or an older spec. If the channel has replicas, waits until it is ready, a few seconds at most.

        Raises StaleBinding (NOT_HERE, WRONG_EPOCH, MOVED), ChannelNotFound, Overloaded, Unavailable.
        """
        await self._learn(channel_id, epoch, spec_version)
        hosted = self._channels.get(channel_id)
        hosted_copies.check_policy(hosted, spec_version)
        if hosted is not None and hosted.replication is not None and not await hosted.replication.ready():
            raise refusals.not_ready(hosted.record.name)
        return self.find_readable(channel_id, epoch, Freshness())

    async def bind_for_feed(self, channel_id: bytes, epoch: int) -> HostedChannel:
        """Bind the channel for a feed. Unlike `bind`, does not wait for the replicas: the feed may belong to a replica.

        Raises the errors of `bind`.
        """
        await self._learn(channel_id, epoch, 0)
        self._check_lease()
        hosted = self._channels.get(channel_id)
        if hosted is None or hosted.is_ready or hosted.epoch != epoch:
            return self.find_readable(channel_id, epoch, Freshness())
        return hosted

    async def become_owner(self, channel_id: bytes, epoch: int) -> None:
        """Own a channel of which this host has a replica: the directory has made this host the owner.

        Raises ChannelNotFound, StaleBinding, Unavailable.
        """
        await self._learn(channel_id, epoch, 0)

    async def _learn(self, channel_id: bytes, epoch: int, spec_version: int) -> None:
        """Ask the directory for the channel, unless this host knows it in this epoch and version."""
        if not self._knows(channel_id, epoch, spec_version):
            async with self._single_flight.about(channel_id):
                if not self._knows(channel_id, epoch, spec_version):
                    await self._ask(channel_id)

    def registering(self, records: Iterable[RecordedChannel], *, is_complete: bool) -> Pieces[None]:
        """Process the directory's answer to a registration, in pieces. The host does not hold the lease meanwhile.

        The store drops the channels that other hosts own now, and takes over new epochs. `is_complete` False: the
        answer does not name all channels of the host. The store then serves an unnamed channel again only after its
        next `bind`.
        """
        self._channels.registrations += 1
        yield from comparing(
            self._channels,
            records,
            self._channels.registrations,
            lambda hosted, record: self._compare(hosted, record, is_complete=is_complete),
            self.scheduler.begin,
        )

    def _compare(
        self, hosted: HostedChannel, record: RecordedChannel | None, *, is_complete: bool
    ) -> list[Pieces[None]]:
        """Adopt `record`, the directory's record of a channel that has not changed here since the registration.

        `record` None: the directory's answer does not name the channel. Then the store drops the channel, and returns
        the rest of that work. If the answer was not complete, the store asks the directory at the next `bind` instead.
        """
        if record is not None and not (record.policy.is_recorded and not hosted.has_same_items(record)):
            self.adopt(record)
        elif is_complete:
            own, host = hosted.record, self._identity.name
            logger.warning("another host has the channel", extra={"event": "channel_moved", "channel": own.name})
            return self._drop(own.channel_id, refusals.not_here(host, own.channel_id))
        else:
            hosted.epoch = 0  # `find` refuses it: the next bind asks the directory
        return []

    def fence(self) -> None:
        """End all waits and streams, because the lease has ended. Callers look for the channels at other hosts."""
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
        for batch in self._channels.batches(CHANNELS_ENDED_PER_PIECE):
            for hosted in batch:
                if self.serves(hosted):  # the channel may have left meanwhile
                    yield from hosted.ending(error)
            yield

    def named_after(self, name: str, count: int) -> list[HostedChannel]:
        """The first `count` channels whose names follow `name`, sorted by name."""
        return self._channels.named_after(name, count)

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
        version = partial(self.version_of, channel_id)
        try:
            record = await confirmed_record(self._directory.resolve, channel_id, version)
        except ChannelNotFound:
            if (held := self._channels.get(channel_id)) is not None:
                self.forget(channel_id, refusals.deleted(held.record.name))
                self.recordings.deleted(held.record)
            raise
        held = self._channels.get(channel_id)
        if record.host_id != self._identity.host_id and is_left_to_move(held):
            raise redirect_error(held) or refusals.moved(record.name, record.host_id)
        if self._identity.host_id in record.copy_host_ids:
            return await self.copies.on_bound(record)
        if record.host_id != self._identity.host_id:
            self.forget(channel_id, error := refusals.moved(record.name, record.host_id))
            raise error
        await self.recordings.adopt(record, held, self.adopt, version)

    def adopt(self, record: RecordedChannel) -> HostedChannel:
        """Serve the channel according to a record of the directory. Ignores a record older than the present one."""
        held = self._channels.get(record.channel_id)
        if held is not None and held.copy is not None and record.epoch > held.record.epoch:  # it is the owner now
            core = None if inherits(held, record) else held.core_of_owner(record)
            if core is not None:
                return self._continue(held, record, core, gone(record.name))
            held = self.copies.inherit(held, record)
        if held is not None and held.record.incarnation == record.incarnation:
            if hosted_copies.ignores(held, record):
                return held
            if hosted_copies.changes_kind(held, record):
                error = refusals.not_here(self._identity.name, record.channel_id)
                return self._continue(held, record, hosted_copies.continued_core(held), error)
            held.registration = self._channels.registrations
            held.update(record)
            return held
        if held is not None:
            if record.epoch < held.record.epoch:
                return held
            self.forget(record.channel_id, refusals.wrong_epoch(record.name, held.record.epoch, record.epoch))
        return self._add(record)

    def _continue(
        self, held: HostedChannel, record: RecordedChannel, core: OwnedCore, error: StampedeError
    ) -> HostedChannel:
        """Serve the items of `held` in another way: as their owner, or with replicas or without.

        Its callers get `error`, and come back with their cursors and numbers.
        """
        logger.info(
            "the host continues a channel",
            extra={"event": "channel_continued", "channel": record.name, "next_seq": core.channel.next_seq},
        )
        core.channel.configure(record.policy, self.now())
        self.departed.add_delivered(held)
        self._take_out(held)
        self.scheduler.begin(held.replaced(error))
        return self._add(record, core)

    def _add(self, record: RecordedChannel, initial: NewCopy | OwnedCore | None = None) -> HostedChannel:
        self._channels.check_room(record.created_by)
        hosted = HostedChannel(
            record,
            self.memory,
            self.now,
            self.sweep.touch,
            self._may_serve,
            self.scheduler.begin,
            self.limits,
            self.deliveries,
            initial,
        )
        hosted.registration = self._channels.registrations
        self._channels.add(hosted)
        if hosted.replication is not None:
            self.on_replicated(hosted)
        return hosted

    def forget(self, channel_id: bytes, error: StampedeError) -> None:
        """Drop the channel, if it is here. Its callers get `error`."""
        self.scheduler.begin(one_after_another(self._drop(channel_id, error)))

    def _drop(self, channel_id: bytes, error: StampedeError) -> list[Pieces[None]]:
        """Drop the channel, and end the calls of some of its callers with `error`. Returns the rest of this work."""
        hosted = self._channels.get(channel_id)
        if hosted is None:
            return []
        self.departed.add_counts(hosted, hosted.core.latest_counters())
        self._take_out(hosted)
        return rest_of(hosted.leaving(error))

    def _take_out(self, hosted: HostedChannel) -> None:
        self._channels.remove(hosted)
        self.sweep.forget(hosted)
