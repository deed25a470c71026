"""The groups of this host: learned from the directory when first named, and looked up again while they are in use."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Coroutine
from typing import Any, NoReturn

from stampede_rt.errors import HostNotFound, Overloaded, StampedeError, error_for
from stampede_rt.v1 import directory_pb2, group_directory_service_pb2, group_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.core.group import TimesBoard
from stampede_rt_channel_host.groups.group_directory import GroupDirectory
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.link import Link
from stampede_rt_channel_host.groups.messages import times_from_message, times_to_message
from stampede_rt_channel_host.groups.own_channels import OwnChannel
from stampede_rt_channel_host.groups.peers import Dial, Peers

logger = logging.getLogger(__name__)

GROUPS_MAX = 10_000
LEARNING_MAX = 1_000
LEARN_PAUSE_SECONDS = 0.2
ROUND_SECONDS = 0.5
LOOK_UP_SECONDS = 30.0  # the directory tells of changes by itself; this is for what goes missing
LOOK_UP_SECONDS_IN_TROUBLE = 0.5
IN_USE_SECONDS = 60.0


class GroupStore:
    """Every request that names a group comes through `find`. Also what the links between hosts tell from and to."""

    def __init__(
        self,
        identity: HostIdentity,
        channels: ChannelStore,
        directory: GroupDirectory,
        dial: Dial,
        cluster_id: Callable[[], str],
    ) -> None:
        self.channels = channels
        self.peers = Peers(identity, self, dial, cluster_id, channels.lease_held)
        self._identity = identity
        self._directory = directory
        self._board = TimesBoard()
        self._groups: dict[bytes, HostedGroup] = {}
        self._groups_of: dict[bytes, set[bytes]] = {}
        self._own: dict[bytes, OwnChannel] = {}
        self._told_all: set[bytes] = set()  # hosts that have told all they know on the link that stands
        self._asking: dict[bytes, asyncio.Lock] = {}
        self._learning: dict[bytes | None, asyncio.Task[None]] = {}  # by group; None: of channels
        self._asked: set[bytes] = set()  # channels that others ask for, and of which no group is known here yet
        self._floors: dict[bytes, group_pb2.CutFloor] = {}  # told of groups that are to be learned first
        self._idling: set[bytes] = set()  # groups whose members may fall idle: signs of life tell of that, too
        self._closed = False
        self.in_use = asyncio.Event()

    def known(self, group_id: bytes) -> HostedGroup | None:
        """The group, if this host has learned of it."""
        group = self._groups.get(group_id)
        if group is not None:
            group.named_s = _now_s()
        return group

    async def find(self, group_id: bytes) -> HostedGroup:
        """The group; the directory is asked if it is new here. Raises GROUP_NOT_FOUND, Overloaded, Unavailable."""
        group = self.known(group_id)
        if group is None and len(group_id) == ID_BYTES:
            await self._look_up(group_id, only_new=True)
            group = self.known(group_id)
        if group is None:
            raise _not_found(group_id)
        return group

    def own(self, channel_id: bytes) -> OwnChannel | None:
        """A member that this host owns and serves."""
        return self._own.get(channel_id)

    async def keep(self) -> NoReturn:
        """Look up the groups in use now and then, and soon where a member is not heard of."""
        while True:  # paced
            await asyncio.sleep(ROUND_SECONDS)
            self.asked_for(set())
            for group_id, group in list(self._groups.items()):
                if self._is_due(group):
                    await self._try_to_look_up(group_id)

    async def aclose(self) -> None:
        """Forget everything."""
        self._closed = True
        for task in list(self._learning.values()):
            task.cancel()
        for own in self._own.values():
            own.let_go()
        await self.peers.aclose()

    def check_serving(self) -> None:
        """Raises StaleBinding if the host may not serve its channels at present."""
        if not self.channels.lease_held():
            raise refusals.fenced(self._identity.name)

    def not_here(self, channel_id: bytes) -> StampedeError:
        """Why a member is not served by this host."""
        return refusals.not_here(self._identity.name, channel_id)

    def fence(self) -> None:
        """The lease ran out: readers of groups must look for their channels elsewhere, or wait."""
        self.end_all(refusals.fenced(self._identity.name))

    def end_all(self, error: StampedeError) -> None:
        """Whoever waits for a group or listens to it hears `error`."""
        for group in self._groups.values():
            group.end(error)

    # What the directory tells by itself.

    def missed(self) -> None:
        """See `WatchedGroups`: they are looked up in the next round."""
        for group in self._groups.values():
            group.looked_up_s = 0.0

    def changed_in_directory(self, change: directory_pb2.DirectoryChange) -> None:
        """See `WatchedGroups`."""
        if change.HasField("group") and change.group.group_id in self._groups:
            self._look_up_soon(change.group.group_id)
        elif change.HasField("channel"):
            for group_id in list(self._groups_of.get(change.channel.channel_id, ())):
                if change.channel.host_id != self._groups[group_id].owners.get(change.channel.channel_id):
                    self._look_up_soon(group_id)

    def _look_up_soon(self, group_id: bytes) -> None:
        self._groups[group_id].looked_up_s = 0.0  # in the next round, if it is being looked up just now
        self._spawn(group_id, self._try_to_look_up(group_id))

    # What links tell from and to.

    def times_of(self, channel_id: bytes) -> group_pb2.ChannelTimes | None:
        """See `Knowledge`."""
        own, heard = self._own.get(channel_id), self._board.find(channel_id)
        if own is None or heard is None:
            return None
        return times_to_message(channel_id, heard.times, heard.silent_nanos(self.channels.now()))

    def floor_of(self, group_id: bytes) -> group_pb2.CutFloor | None:
        """See `Knowledge`."""
        group = self._groups.get(group_id)
        return None if group is None else group.floor()

    def greeted(self, link: Link) -> None:
        """See `Knowledge`."""
        self._told_all.discard(link.host_id)
        self.peers.greeted(link)

    def asked_for(self, channel_ids: set[bytes]) -> None:
        """See `Knowledge`. The other host knows groups of these channels, of which this one may not have heard."""
        self._asked |= channel_ids - self._own.keys()
        if self._asked:
            self._spawn(None, self._learn_groups_of_asked())

    def check_lease(self) -> None:
        """See `Knowledge`."""
        if not self.channels.lease_held():
            raise HostNotFound(f"host {self._identity.name} has no lease at present and speaks for no channel; wait")

    def hear(self, host_id: bytes, update: pb.TimesUpdate, *, is_first: bool) -> None:
        """See `Knowledge`. Only of channels that the other host owns, as the directory says."""
        now, wanted = self.channels.now(), self.peers.wanted_of(host_id)
        self._board.confirm(wanted, now)
        news = {one for one in self._idling if host_id in self._groups[one].targets}
        for told in update.times:
            if told.channel_id in wanted:
                times = times_from_message(told)
                if self._board.hear(told.channel_id, times, told.silent_nanos, now):
                    news |= self._groups_of.get(told.channel_id, set())
        news |= {floor.group_id for floor in update.floors if self._merge(floor)}
        if is_first:
            self._told_all.add(host_id)
            news |= {one for one, group in self._groups.items() if host_id in group.unheard}
        for group_id in news:
            self._look(self._groups[group_id])

    def _merge(self, floor: group_pb2.CutFloor) -> bool:
        """Take in another host's floor; True if it is further. What is new or newer is asked of the directory."""
        group = self._groups.get(floor.group_id)
        if group is not None and group.record.incarnation == floor.incarnation:
            if floor.spec_version > group.record.spec_version:
                self._spawn(floor.group_id, self._try_to_look_up(floor.group_id))
            return group.cut.merge_floor(floor.cut_unix_nano)
        held = self._floors.get(floor.group_id)
        if held is not None or len(self._floors) < GROUPS_MAX:
            further = held is None or held.incarnation != floor.incarnation or held.cut_unix_nano < floor.cut_unix_nano
            self._floors[floor.group_id] = floor if held is None or further else held
            self._spawn(floor.group_id, self._try_to_look_up(floor.group_id))
        return False

    def _spawn(self, about: bytes | None, work: Coroutine[Any, Any, None]) -> None:
        """Ask the directory beside the link that gave cause to: about each thing once at a time, and not too often.

        What is left out here is asked in the next round, or by who names the group.
        """
        if self._closed or about in self._learning or len(self._learning) >= LEARNING_MAX:
            work.close()
            return
        task = self._learning[about] = asyncio.create_task(_paced(work))
        task.add_done_callback(lambda _: self._learning.pop(about, None))

    async def _learn_groups_of_asked(self) -> None:
        while self._asked:
            channel_id = min(self._asked)
            try:
                for group_id in await self._directory.groups_of(channel_id):
                    await self._look_up(group_id, only_new=True)
            except StampedeError as error:
                logger.debug("cannot learn the groups of a channel", extra={"why": str(error)})
                return  # the next round tries again
            self._asked.discard(channel_id)

    # What the directory says.

    def _is_due(self, group: HostedGroup) -> bool:
        since_s = _now_s() - group.looked_up_s
        if since_s < LOOK_UP_SECONDS_IN_TROUBLE:
            return False
        if self._neglects_own(group):
            return True  # others may wait for this host, though nobody reads the group here
        if not group.listeners and _now_s() - group.named_s > IN_USE_SECONDS:
            return False
        return since_s >= LOOK_UP_SECONDS or self._misses_a_host(group)

    def _neglects_own(self, group: HostedGroup) -> bool:
        """A member that this host owns, as far as it knows, is not followed."""
        own = self._identity.host_id
        return any(host_id == own and channel_id not in self._own for channel_id, host_id in group.owners.items())

    def _misses_a_host(self, group: HostedGroup) -> bool:
        """A host is not heard of: it may be gone, and another one may own its channels."""
        others = {host_id for host_id in group.owners.values() if host_id != self._identity.host_id}
        return bool(group.unheard) or not all(self.peers.is_linked(one) for one in others)

    async def _try_to_look_up(self, group_id: bytes) -> None:
        try:
            await self._look_up(group_id, only_new=False)
        except StampedeError as error:
            logger.debug("cannot look up a group", extra={"group": group_id.hex(), "why": str(error)})

    async def _look_up(self, group_id: bytes, *, only_new: bool) -> None:
        lock = self._asking.setdefault(group_id, asyncio.Lock())
        try:
            async with lock:  # of many callers at once one asks
                if not only_new or group_id not in self._groups:
                    await self._ask(group_id)
        finally:
            if not lock.locked():
                self._asking.pop(group_id, None)

    async def _ask(self, group_id: bytes) -> None:
        known = self._groups.get(group_id)
        if known is None and len(self._groups) >= GROUPS_MAX:
            raise Overloaded(f"host {self._identity.name} has {GROUPS_MAX} groups, which is the most; use another")
        try:
            told = await self._directory.resolve(group_id)
        except StampedeError as error:
            if error.reason == "GROUP_NOT_FOUND":
                self._floors.pop(group_id, None)
                if known is not None:
                    self._forget(group_id, error)
            raise
        places = (known.owners, known.targets) if known is not None else None
        group = self._adopt(group_id, told)
        group.looked_up_s = _now_s()
        await self._bind_own(group)
        if places != (group.owners, group.targets):
            self._share()
        self._look(group)

    def _adopt(self, group_id: bytes, told: group_directory_service_pb2.ResolveGroupResponse) -> HostedGroup:
        group = self._groups.get(group_id)
        if group is None:
            group = HostedGroup(told, self._board, self.channels.now, self.peers.tell_floor)
            group.named_s = _now_s()
            self._groups[group_id] = group
            self.in_use.set()
        elif (told.group.spec_version, told.group.incarnation) != (group.record.spec_version, group.record.incarnation):
            self._leave(group, set(told.group.spec.channel_ids))
            if group.adopt(told):
                group.end(_anew(told.group))
            self.peers.tell_floor(group_id)  # with it goes the version, so that the others ask, too
        else:
            group.adopt(told)
        for channel_id in told.group.spec.channel_ids:
            self._groups_of.setdefault(channel_id, set()).add(group_id)
        if group.cut.definition.idle_after_nanos is not None:
            self._idling.add(group_id)
        floor = self._floors.pop(group_id, None)
        if floor is not None and floor.incarnation == told.group.incarnation:
            group.cut.merge_floor(floor.cut_unix_nano)
        if not group.cut.is_settled:
            group.unheard = {one for one in group.targets if one != self._identity.host_id}
        return group

    async def _bind_own(self, group: HostedGroup) -> None:
        """Follow the members that this host owns."""
        for channel_id, record in group.channels.items():
            if record.host_id != self._identity.host_id:
                continue
            try:
                hosted = await self.channels.bind(channel_id, record.epoch)
            except StampedeError as error:
                logger.debug("cannot serve a member", extra={"channel": record.name, "why": str(error)})
                continue
            held = self._own.get(channel_id)
            if held is not None and held.hosted is hosted:
                held.tell()
            else:
                if held is not None:
                    held.let_go()
                self._own[channel_id] = OwnChannel(
                    hosted, self._board, self.channels.now, on_change=self._changed, on_end=self._ended
                )
                self.peers.tell_times(channel_id)

    def _share(self) -> None:
        """Who the other hosts are, and what is wanted of them."""
        targets: dict[bytes, str] = {}
        wanted: dict[bytes, set[bytes]] = {}
        shared: dict[bytes, set[bytes]] = {}
        for group_id, group in self._groups.items():
            targets |= group.targets
            for channel_id, host_id in group.owners.items():
                if host_id != self._identity.host_id:
                    wanted.setdefault(host_id, set()).add(channel_id)
                    shared.setdefault(host_id, set()).add(group_id)
        self.peers.share(targets, wanted, shared)

    def _look(self, group: HostedGroup) -> None:
        """Settle the group if all have told, and see where its cut is."""
        group.unheard = {one for one in group.unheard if one not in self._told_all or not self.peers.is_linked(one)}
        if not group.unheard and not group.cut.is_settled:
            group.cut.settle()
            self.peers.tell_floor(group.record.group_id)
        group.changed()

    def _changed(self, channel_id: bytes) -> None:
        """A channel of this host has changed."""
        self.peers.tell_times(channel_id)
        for group_id in self._groups_of.get(channel_id, ()):
            self._groups[group_id].changed()

    def _ended(self, channel_id: bytes) -> None:
        """A channel is not served here any more; who owns it now is asked soon."""
        self._own.pop(channel_id, None)
        for group_id in self._groups_of.get(channel_id, ()):
            self._groups[group_id].looked_up_s = 0.0
            self._groups[group_id].changed()

    def _forget(self, group_id: bytes, error: StampedeError) -> None:
        group = self._groups.pop(group_id)
        self._idling.discard(group_id)
        self._leave(group, set())
        self._share()
        group.end(error)

    def _leave(self, group: HostedGroup, staying: set[bytes]) -> None:
        """The group has its other members no more; what no group has is not followed."""
        for channel_id in set(group.record.spec.channel_ids) - staying:
            of_channel = self._groups_of.get(channel_id, set())
            of_channel.discard(group.record.group_id)
            if not of_channel:
                self._groups_of.pop(channel_id, None)
                if (own := self._own.pop(channel_id, None)) is not None:
                    own.let_go()
        self._board.keep_only(set(self._groups_of))


async def _paced(work: Coroutine[Any, Any, None]) -> None:
    await work
    await asyncio.sleep(LEARN_PAUSE_SECONDS)


def _now_s() -> float:
    return asyncio.get_running_loop().time()


def _not_found(group_id: bytes) -> StampedeError:
    shown = group_id.hex()
    return error_for("GROUP_NOT_FOUND", f"there is no group {shown}; it may have been deleted", {"group_id": shown})


def _anew(record: group_pb2.GroupRecord) -> StampedeError:
    return error_for(
        "INCARNATION_LOST",
        f"group {record.name} began anew, since all hosts of its members were restarted: where its cut was is not "
        "known any more; read it from now on",
        {"group": record.name},
    )
