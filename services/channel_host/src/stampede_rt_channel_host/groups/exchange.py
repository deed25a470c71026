"""The messages between hosts about groups (paper, section 4.1): times, cuts, and the channels of interest to a host."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from stampede_rt.errors import HostNotFound
from stampede_rt.v1 import group_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.channels.observers import Backlog
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.cut_floors import floor_from_message
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.core.group import CutFloor
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.link import HostLink
from stampede_rt_channel_host.groups.messages import times_from_message, times_to_message
from stampede_rt_channel_host.groups.sharing_hosts import ChangedMembers, Dial, SharingHosts
from stampede_rt_channel_host.groups.table import HostedGroups

FLOORS_MAX = 10_000  # the most floors of groups that this host has still to look up
FLOORS_MAX_PER_HOST = 1000  # the most of these floors that one host has reported
GROUPS_PER_PIECE = 16


class TimesExchange:
    """Implements `LinkHandler`: gives the links the messages to send, and processes the messages of other hosts.

    Calls `on_stale` with groups that this host does not know, or of which other hosts know a newer version. Calls
    `on_requested` with channels of this host that other hosts believe to be members of groups.
    """

    def __init__(
        self,
        identity: HostIdentity,
        channels: ChannelStore,
        table: HostedGroups,
        dial: Dial,
        cluster_id: Callable[[], str],
        *,
        on_stale: Callable[[bytes], None],
        on_requested: Callable[[set[bytes]], None],
    ) -> None:
        self._to_look_at: Backlog[bytes] = Backlog(self._look_at, channels.scheduler.begin, GROUPS_PER_PIECE)
        self.sharing_hosts = SharingHosts(identity, self, dial, cluster_id, channels.lease_held)
        self._identity = identity
        self._channels = channels
        self._table = table
        self._on_stale = on_stale
        self._on_requested = on_requested
        self._names: dict[bytes, str] = {}  # host id -> name, of the hosts of known groups
        # The channels of other hosts about which this host wants to receive: by group and host.
        self._members: dict[bytes, dict[bytes, list[bytes]]] = {}
        self._creators: dict[bytes, str] = {}  # the caller that created each of these groups
        self._fully_reported: set[bytes] = set()  # hosts that have sent all their times on the present link
        # Floors of groups that this host has still to look up: by group, then by host.
        self._floors: dict[bytes, dict[bytes, CutFloor]] = {}
        self._waiting_floors: Counter[bytes] = Counter()  # the number of floors in `_floors` of each host

    def share(self, group_id: bytes) -> None:
        """Tell the links which channels this host wants to receive about, after a change of the group or its owners.

        The duration of this call grows with the hosts and channels of this group, not with the number of groups.
        """
        group = self._table.groups.get(group_id)
        former, members = self._members.pop(group_id, {}), _by_host(group, self._identity.host_id)
        creator = self._creators.pop(group_id, "" if group is None else group.record.created_by)
        if group is not None and members:
            self._members[group_id], self._creators[group_id] = members, creator
            self._names |= group.host_names
        for host_id in former.keys() | members.keys():
            target = group.targets.get(host_id) if group is not None else None
            change = ChangedMembers(creator, group_id, former.get(host_id, ()), members.get(host_id, ()))
            if not self.sharing_hosts.share(host_id, target, change):
                self._names.pop(host_id, None)

    def look(self, group: HostedGroup) -> None:
        """Refresh the group. If all its hosts have reported their cuts now, confirm the group's cut first."""
        group.awaited_hosts = {
            one
            for one in group.awaited_hosts
            if one not in self._fully_reported or not self.sharing_hosts.is_linked(one)
        }
        if not group.awaited_hosts and not group.cut.is_confirmed:
            group.cut.confirm()
            self.sharing_hosts.report_floor(group.record.group_id)
        self._table.refresh(group)

    def take_floors(self, group_id: bytes) -> dict[bytes, CutFloor]:
        """Return the floors of a group that this host has kept until the directory's answer, by host. Forget them."""
        floors = self._floors.pop(group_id, {})
        self._waiting_floors -= Counter(floors.keys())
        return floors

    def inherit_floors(self, floors: Sequence[CutFloor]) -> None:
        """Take over the cuts of groups of which a member has moved here. The groups get them with their new owners."""
        for floor in floors:
            self._keep_floor(self._identity.host_id, floor)

    # The methods that links call.

    def times_of(self, channel_id: bytes) -> group_pb2.ChannelTimes | None:
        """See `LinkHandler`."""
        own, known = self._table.own.get(channel_id), self._table.board.find(channel_id)
        if own is None or known is None:
            return None
        return times_to_message(channel_id, known.times, known.silent_nanos(self._channels.now()))

    def floor_of(self, group_id: bytes) -> CutFloor | None:
        """See `LinkHandler`."""
        group = self._table.groups.get(group_id)
        return None if group is None else group.floor()

    def name_of_host(self, host_id: bytes) -> str:
        """See `LinkHandler`."""
        return self._names.get(host_id, "")

    def greeted(self, link: HostLink) -> None:
        """See `LinkHandler`."""
        self._fully_reported.discard(link.host_id)
        self.sharing_hosts.greeted(link)

    def channels_requested(self, channel_ids: set[bytes]) -> None:
        """See `LinkHandler`."""
        self._on_requested(channel_ids)

    def check_lease(self) -> None:
        """See `LinkHandler`."""
        if not self._channels.lease_held():
            raise HostNotFound(
                f"host {self._identity.name} has no lease at present and cannot report for its channels; wait"
            )

    def receive(self, host_id: bytes, update: pb.TimesUpdate, *, is_first: bool) -> None:
        """See `LinkHandler`. Accepts only times of channels that the other host owns, as the directory says."""
        table, now, wanted = self._table, self._channels.now(), self.sharing_hosts.wanted_of(host_id)
        table.board.confirm(wanted, now)
        changed: set[bytes] = set()
        is_silent = True
        for reported in update.times:
            if reported.channel_id in wanted and table.ids_of(reported.channel_id):
                times = times_from_message(reported)
                is_new = table.board.receive(reported.channel_id, times, reported.silent_nanos, now)
                concerned = table.concerned_by(reported.channel_id)
                changed |= {one.record.group_id for one in concerned if is_new or one.record.group_id in table.idling}
                is_silent = is_silent and not is_new
        floors = map(floor_from_message, update.floors)
        changed |= {floor.group_id for floor in floors if self._merge(host_id, floor)}
        if is_silent and not changed:  # a sign of life: channels of the other host may have become idle
            changed |= {one for one in table.idling if host_id in table.groups[one].targets}
        if is_first:
            self._fully_reported.add(host_id)
            changed |= {one for one, group in table.groups.items() if host_id in group.awaited_hosts}
        self._to_look_at.add(changed)

    def _look_at(self, group_id: bytes) -> None:
        group = self._table.groups.get(group_id)
        if group is not None:
            self.look(group)

    def _merge(self, host_id: bytes, floor: CutFloor) -> bool:
        """Process another host's floor. Returns True if this raised the cut.

        Asks the directory about the group if this host does not know the group in the incarnation or version of the
        floor.
        """
        group = self._table.groups.get(floor.group_id)
        if group is None or group.record.incarnation != floor.incarnation:
            self._keep_floor(host_id, floor)
            return False
        if floor.spec_version > group.record.spec_version:
            self._on_stale(floor.group_id)
            if host_id not in group.owners.values():  # the host may own a member since that version
                self._keep_floor(host_id, floor)
        return group.merge_floor(host_id, floor)

    def _keep_floor(self, host_id: bytes, floor: CutFloor) -> None:
        """Keep the host's highest floor until the directory has answered. Drops the floor beyond the limits."""
        floors = self._floors.get(floor.group_id, {})
        held = floors.get(host_id)
        if held is None:
            if self._waiting_floors.total() >= FLOORS_MAX or self._waiting_floors[host_id] >= FLOORS_MAX_PER_HOST:
                return
            self._waiting_floors[host_id] += 1
        if held is None or held.incarnation != floor.incarnation or held.cut < floor.cut:
            self._floors.setdefault(floor.group_id, {})[host_id] = floor
        self._on_stale(floor.group_id)


def _by_host(group: HostedGroup | None, own_id: bytes) -> dict[bytes, list[bytes]]:
    """The members of a group that other hosts own, by host; empty for None."""
    members: dict[bytes, list[bytes]] = {}
    for channel_id, host_id in group.owners.items() if group is not None else ():
        if host_id != own_id:
            members.setdefault(host_id, []).append(channel_id)
    return members
