"""The groups that a host knows, the channels of each, and the times of the channels."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from stampede_rt_channel_host.channels.observers import ChangeObserver
from stampede_rt_channel_host.core.group import TimesBoard
from stampede_rt_channel_host.core.records import ResolvedGroup
from stampede_rt_channel_host.groups.hosted_group import HostedGroup
from stampede_rt_channel_host.groups.own_channels import OwnChannel


class HostedGroups:
    """The table of groups, by id. `board` has the times of their members, also of members at other hosts.

    `own`: the members that this host owns and serves. `idling`: the ids of the groups whose members may become idle.
    """

    def __init__(self) -> None:
        self.board = TimesBoard()
        self.groups: dict[bytes, HostedGroup] = {}
        self.own: dict[bytes, OwnChannel] = {}
        self.idling: set[bytes] = set()
        self._groups_of: dict[bytes, set[bytes]] = {}  # by channel id: the ids of the channel's groups
        self._concerned: dict[bytes, dict[HostedGroup, None]] = {}  # by channel id: the groups that its change concerns
        self._keys: dict[bytes, Collection[bytes]] = {}  # by group id: the channel ids with it in `_concerned`

    def ids_of(self, channel_id: bytes) -> set[bytes]:
        """The ids of the groups that the channel is a member of, as far as this host knows."""
        return self._groups_of.get(channel_id, set())

    def groups_of(self, channel_id: bytes) -> Iterator[HostedGroup]:
        """The groups that the channel is a member of, as far as this host knows."""
        return (self.groups[group_id] for group_id in tuple(self.ids_of(channel_id)))

    def concerned_by(self, channel_id: bytes) -> list[HostedGroup]:
        """The groups of the channel that a change of the channel's times concerns.

        A channel may be in very many groups, and each put changes its times. The result lacks the groups whose cut
        another member holds back.
        """
        return [*self._concerned.get(channel_id, ())]

    def refresh(self, group: HostedGroup) -> None:
        """Compute the group's cut again. See `HostedGroup.changed`."""
        group.changed()
        self._file(group)

    def observe(self, group: HostedGroup, observer: ChangeObserver, *, of_members: bool) -> None:
        """Have the group wake `observer` when it shows more. `of_members`: also after each change of a member."""
        (group.member_observers if of_members else group.cut_observers).add(observer)
        self._file(group)

    def stop_observing(self, group: HostedGroup, observer: ChangeObserver) -> None:
        """End the effect of `observe`. Idempotent."""
        group.member_observers.discard(observer)
        group.cut_observers.discard(observer)
        self._file(group)

    def _file(self, group: HostedGroup) -> None:
        if self.groups.get(group.record.group_id) is group:  # the group may have been deleted meanwhile
            self._note_keys(group, group.members_to_watch())

    def _note_keys(self, group: HostedGroup, keys: Collection[bytes]) -> None:
        before = self._keys.pop(group.record.group_id, ())
        if keys:
            self._keys[group.record.group_id] = keys
        if keys == before:
            return
        for channel_id in before:
            concerned = self._concerned[channel_id]
            concerned.pop(group, None)
            if not concerned:
                del self._concerned[channel_id]
        for channel_id in keys:
            self._concerned.setdefault(channel_id, {})[group] = None

    def enter(self, group: HostedGroup) -> None:
        """Enter a group that is new here or has other members now."""
        group_id = group.record.group_id
        self.groups[group_id] = group
        for channel_id in group.record.definition.members:
            self._groups_of.setdefault(channel_id, set()).add(group_id)
        if group.cut.definition.idle_after_nanos is not None:
            self.idling.add(group_id)
        self._file(group)

    def adopt(self, group: HostedGroup, resolved: ResolvedGroup) -> bool:
        """Take over the directory's answer about a group. Returns True if the group began anew."""
        self._leave(group, resolved.group.definition.members)
        is_anew = group.adopt(resolved)
        self.enter(group)
        return is_anew

    def forget(self, group_id: bytes) -> HostedGroup:
        """Remove a group that the directory has deleted."""
        group = self.groups.pop(group_id)
        self.idling.discard(group_id)
        self._note_keys(group, ())
        self._leave(group, frozenset())
        return group

    def _leave(self, group: HostedGroup, staying: frozenset[bytes]) -> None:
        """Take all members except `staying` out of the group.

        If a channel is in no other group, this host does not follow it any more.
        """
        for channel_id in group.record.definition.members - staying:
            group_ids = self._groups_of.get(channel_id, set())
            group_ids.discard(group.record.group_id)
            if not group_ids:
                self._groups_of.pop(channel_id, None)
                if (own := self.own.pop(channel_id, None)) is not None:
                    own.stop_following()
                self.board.forget(channel_id)
