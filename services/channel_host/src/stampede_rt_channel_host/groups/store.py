"""The groups of this host. The host learns a group from the directory at its first use, and looks it up again later."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection, Sequence
from typing import NoReturn

from stampede_rt.errors import Overloaded, StampedeError, error_for
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.hosted_channels import HostedChannel
from stampede_rt_channel_host.channels.observers import Backlog, ChangeObserver
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.cluster.single_flight import SingleFlight
from stampede_rt_channel_host.core.channel import Pieces, batched
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_channel_host.core.records import RecordedChange, ResolvedGroup
from stampede_rt_channel_host.groups.background_lookups import BackgroundLookups
from stampede_rt_channel_host.groups.exchange import TimesExchange
from stampede_rt_channel_host.groups.group_directory import GroupDirectory
from stampede_rt_channel_host.groups.hosted_group import HostedGroup, began_anew
from stampede_rt_channel_host.groups.own_channels import OwnChannel
from stampede_rt_channel_host.groups.sharing_hosts import Dial
from stampede_rt_channel_host.groups.table import HostedGroups

logger = logging.getLogger(__name__)

GROUPS_MAX = 10_000
GROUPS_PER_PIECE = 16
GROUPS_PER_LOOK = 256
ROUND_SECONDS = 0.5
LOOK_UP_SECONDS = 30.0  # between two lookups of a group in use; they find changes that the watch has missed
LOOK_UP_SECONDS_IN_TROUBLE = 0.5  # as above, if the group may have changed or a host is silent
IN_USE_SECONDS = 60.0  # a group without readers counts as in use for this time after the last request that named it


class GroupStore:
    """Requests that name a group get it by `find`, or by `known` if they must not wait. Implements `ChangeFollower`."""

    def __init__(
        self,
        identity: HostIdentity,
        channels: ChannelStore,
        directory: GroupDirectory,
        dial: Dial,
        cluster_id: Callable[[], str],
    ) -> None:
        self.channels = channels
        self._identity = identity
        self._directory = directory
        self._table = HostedGroups()
        self.exchange = TimesExchange(
            identity, channels, self._table, dial, cluster_id, on_stale=self._look_up_soon, on_requested=self._learn_of
        )
        self._single_flight = SingleFlight()
        self._lookups = BackgroundLookups()
        self._changed_groups: Backlog[HostedGroup] = Backlog(
            self._table.refresh, channels.scheduler.begin, GROUPS_PER_PIECE
        )
        self._to_learn: set[bytes] = set()  # channels that other hosts ask for, in no group that this host knows
        self.in_use = asyncio.Event()  # set as soon as this host has learned a group

    def known(self, group_id: bytes) -> HostedGroup | None:
        """The group, if this host knows it; otherwise None. Notes that a request has named the group."""
        group = self._table.groups.get(group_id)
        if group is not None:
            group.named_s = _now_s()
        return group

    async def find(self, group_id: bytes, spec_version: int = 0) -> HostedGroup:
        """The group. Asks the directory if this host does not know the group, or knows a version below `spec_version`.

        Raises GROUP_NOT_FOUND, Overloaded, Unavailable.
        """
        group = self.known(group_id)
        if group is None and len(group_id) == ID_BYTES:
            await self._look_up(group_id, only_new=True)
            group = self.known(group_id)
        elif group is not None and group.record.spec_version < spec_version:
            await self._look_up(group_id, only_new=False)
        if group is None:
            raise _not_found(group_id)
        return group

    def observe(self, group: HostedGroup, observer: ChangeObserver, *, of_members: bool) -> None:
        """See `HostedGroups`."""
        self._table.observe(group, observer, of_members=of_members)

    def stop_observing(self, group: HostedGroup, observer: ChangeObserver) -> None:
        """See `HostedGroups`."""
        self._table.stop_observing(group, observer)

    def all(self) -> list[HostedGroup]:
        """All groups that this host knows."""
        return list(self._table.groups.values())

    def ids_of(self, channel_id: bytes) -> Collection[bytes]:
        """The ids of the channel's groups that this host knows."""
        return self._table.ids_of(channel_id)

    def floors_of(self, channel_id: bytes) -> list[CutFloor]:
        """The cuts of the channel's groups that this host knows and has confirmed."""
        if not self._table.ids_of(channel_id):
            return []
        floors = (group.floor() for group in self._table.groups_of(channel_id) if group.cut.is_confirmed)
        return [one for one in floors if one is not None]

    def own(self, channel_id: bytes) -> OwnChannel | None:
        """The channel, if it is a member that this host owns and serves; otherwise None."""
        return self._table.own.get(channel_id)

    async def keep(self) -> NoReturn:
        """Look up the groups in use from time to time.

        Looks up a group sooner if the group may have changed, or if one of its hosts is silent.
        """
        while True:  # paced by the sleep
            await asyncio.sleep(ROUND_SECONDS)
            self._learn_of(set())
            for part in batched(list(self._table.groups.items()), GROUPS_PER_LOOK):
                for group_id, group in part:
                    if self._is_due(group):
                        await self._look_up_again(group_id)
                await asyncio.sleep(0)

    async def aclose(self) -> None:
        """Stop all lookups, links and followed channels."""
        self._lookups.close()
        for own in self._table.own.values():
            own.stop_following()
        await self.exchange.sharing_hosts.aclose()

    def check_serving(self) -> None:
        """Raises StaleBinding if the host may not serve its channels at present."""
        if not self.channels.lease_held():
            raise refusals.fenced(self._identity.name)

    def not_here(self, channel_id: bytes) -> StampedeError:
        """The error for a member that this host does not serve."""
        return refusals.not_here(self._identity.name, channel_id)

    def fence(self) -> None:
        """End all waits and streams, because the lease has ended. Readers then ask other hosts, or wait."""
        self.end_all(refusals.fenced(self._identity.name))

    def end_all(self, error: StampedeError) -> None:
        """End the waits of all callers and the streams of all readers of groups with `error`.

        If there are many, the last ones end a moment later.
        """
        self.channels.scheduler.begin(_ending(list(self._table.groups.values()), error))

    # Reports from the directory and from other hosts.

    async def missed(self) -> None:
        """See `ChangeFollower`. The next round of `keep` looks up all groups."""
        for group in self._table.groups.values():
            group.is_stale = True

    def changed_in_directory(self, change: RecordedChange) -> None:
        """See `ChangeFollower`."""
        if change.group_id in self._table.groups:
            self._look_up_soon(change.group_id)
        elif change.channel is not None:
            for group in self._table.groups_of(change.channel.channel_id):
                if change.channel.host_id != group.owners.get(change.channel.channel_id):
                    self._look_up_soon(group.record.group_id)

    def _look_up_soon(self, group_id: bytes) -> None:
        """Look up a group in the background. If that fails and this host knows the group, `keep` looks it up again."""
        group = self._table.groups.get(group_id)
        if group is not None:
            group.is_stale = True
        self._lookups.start(group_id, self._look_up(group_id, only_new=False))

    def _learn_of(self, channel_ids: set[bytes]) -> None:
        """Look up the groups of these channels in the background, because other hosts may know groups, or versions of
        groups, that this host does not know.
        """
        self._to_learn |= channel_ids - self._table.own.keys()
        if self._to_learn:
            self._lookups.start(None, self._learn_groups())

    async def _learn_groups(self) -> None:
        while self._to_learn:
            channel_id = min(self._to_learn)
            for group_id in await self._directory.groups_of(channel_id):
                await self._look_up(group_id, only_new=group_id in self._table.ids_of(channel_id))
            self._to_learn.discard(channel_id)

    # The directory's answers.

    def _is_due(self, group: HostedGroup) -> bool:
        since_s = _now_s() - group.looked_up_s
        if since_s < LOOK_UP_SECONDS_IN_TROUBLE:
            return False
        if group.is_stale:
            return True  # other hosts may wait for this host, even if nobody here reads the group
        has_callers = group.cut_observers or group.member_observers or group.gets
        if not has_callers and _now_s() - group.named_s > IN_USE_SECONDS:
            return False
        return since_s >= LOOK_UP_SECONDS or self._misses_a_host(group)

    def _misses_a_host(self, group: HostedGroup) -> bool:
        """Whether another host of the group is silent. That host may be gone, and its channels may have new owners."""
        others = {host_id for host_id in group.owners.values() if host_id != self._identity.host_id}
        return bool(group.awaited_hosts) or not all(self.exchange.sharing_hosts.is_linked(one) for one in others)

    async def _look_up_again(self, group_id: bytes) -> None:
        try:
            await self._look_up(group_id, only_new=False)
        except StampedeError as error:
            logger.debug(
                "cannot look up a group",
                extra={"event": "group_lookup_failed", "group": group_id.hex(), "why": str(error)},
            )

    async def _look_up(self, group_id: bytes, *, only_new: bool) -> None:
        async with self._single_flight.about(group_id):
            if not only_new or group_id not in self._table.groups:
                await self._ask(group_id)

    async def _ask(self, group_id: bytes) -> None:
        known = self._table.groups.get(group_id)
        if known is None and len(self._table.groups) >= GROUPS_MAX:
            raise Overloaded(f"host {self._identity.name} has {GROUPS_MAX} groups, the limit; use another host")
        if known is not None:
            known.is_stale = False  # a later change causes another lookup
        try:
            resolved = await self._directory.resolve(group_id)
        except StampedeError as error:
            self._refused(group_id, known, error)
            raise
        former_hosts = (known.owners, known.targets) if known is not None else None
        group = self._adopt(group_id, resolved)
        group.looked_up_s = _now_s()
        self._table.board.confirm(group.ownerless(), self.channels.now())
        await self._bind_own(group)
        if former_hosts != (group.owners, group.targets):
            self.exchange.share(group_id)
        self.exchange.look(group)

    def _refused(self, group_id: bytes, known: HostedGroup | None, error: StampedeError) -> None:
        if error.reason != "GROUP_NOT_FOUND":
            if known is not None:
                known.is_stale = True
            return
        self.exchange.take_floors(group_id)
        if known is not None:
            self._table.forget(group_id)
            self._changed_groups.drop(known)
            self.exchange.share(group_id)
            known.end(error)

    def _adopt(self, group_id: bytes, resolved: ResolvedGroup) -> HostedGroup:
        group = self._table.groups.get(group_id)
        if group is None:
            sharing_hosts = self.exchange.sharing_hosts
            group = HostedGroup(
                resolved,
                self._table.board,
                self.channels.now,
                on_moved=sharing_hosts.report_floor,
                on_idle=sharing_hosts.report_times,
                begin=self.channels.scheduler.begin,
            )
            group.named_s = _now_s()
            self._table.enter(group)
            self.in_use.set()
        else:
            version = group.record.spec_version, group.record.incarnation
            if self._table.adopt(group, resolved):
                group.end(began_anew(resolved.group))
            if version != (resolved.group.spec_version, resolved.group.incarnation):
                # the message has the version, so that the other hosts look up the group, too
                self.exchange.sharing_hosts.report_floor(group_id)
        for host_id, floor in self.exchange.take_floors(group_id).items():
            group.merge_floor(host_id, floor)
        if not group.cut.is_confirmed:
            group.awaited_hosts = {one for one in group.targets if one != self._identity.host_id}
        return group

    async def _bind_own(self, group: HostedGroup) -> None:
        """Follow the members that this host owns."""
        for channel_id, record in group.channels.items():
            if record.host_id != self._identity.host_id:
                continue
            try:
                hosted = await self.channels.bind(channel_id, record.epoch)
            except StampedeError as error:
                logger.debug(
                    "cannot serve a member",
                    extra={"event": "group_member_not_served", "channel": record.name, "why": str(error)},
                )
                group.is_stale = True
                continue
            self._follow(channel_id, hosted)

    def _follow(self, channel_id: bytes, hosted: HostedChannel) -> None:
        held = self._table.own.get(channel_id)
        if held is not None and held.hosted is hosted:
            held.enter_times()
            return
        if held is not None:
            held.stop_following()
        self._table.own[channel_id] = OwnChannel(
            hosted, self._table.board, self.channels.now, on_change=self._changed, on_end=self._ended
        )
        self._note_new_generation(channel_id)
        self.exchange.sharing_hosts.report_times(channel_id)

    def _changed(self, channel_id: bytes) -> None:
        """Report a change of a channel of this host."""
        self.exchange.sharing_hosts.report_times(channel_id)
        self._changed_groups.add(self._table.concerned_by(channel_id))

    def _ended(self, channel_id: bytes) -> None:
        """Stop following a channel that this host no longer serves. The next round of `keep` looks up its groups."""
        self._table.own.pop(channel_id, None)
        self._note_new_generation(channel_id)
        for group in self._table.groups_of(channel_id):
            group.is_stale = True

    def _note_new_generation(self, channel_id: bytes) -> None:
        for group in self._table.groups_of(channel_id):
            group.generation += 1
        self._changed_groups.add(self._table.groups_of(channel_id))


def _ending(groups: Sequence[HostedGroup], error: StampedeError) -> Pieces[None]:
    for part in batched(groups, GROUPS_PER_PIECE):
        for group in part:
            yield from group.ending(error)
        yield


def _now_s() -> float:
    return asyncio.get_running_loop().time()


def _not_found(group_id: bytes) -> StampedeError:
    shown = group_id.hex()
    return error_for("GROUP_NOT_FOUND", f"there is no group {shown}; it may have been deleted", {"group_id": shown})
