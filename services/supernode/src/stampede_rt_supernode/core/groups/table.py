"""The groups of the directory, by id, by name and by member (paper, section 3.3). Pure.

Every edit is atomic and keeps the invariants stated beside the attributes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from sortedcontainers import SortedDict

from stampede_rt_supernode.core.records import ChangeKind, GroupRecord

Note = Callable[[ChangeKind, GroupRecord], None]
GroupWithWitnesses = tuple[GroupRecord, tuple[bytes, ...]]


class GroupTable:
    """`note` is told of every change. A witness is a host of members that still knows the cut of the present
    incarnation, since it has not started anew after that was set."""

    def __init__(self, entries: Iterable[GroupWithWitnesses], note: Note) -> None:
        self._note = note
        self.by_id: dict[bytes, GroupRecord] = {}
        self.ids: SortedDict[str, bytes] = SortedDict()  # by name; exactly the groups
        self._entries: dict[bytes, GroupWithWitnesses] = {}  # by id; host ids ascending, never none
        self._ids_with: dict[bytes, set[bytes]] = {}  # by channel id; only channels that are in a group
        for group, witnesses in entries:
            self._link(group, witnesses)

    def __len__(self) -> int:
        return len(self.by_id)

    def named(self, name: str) -> GroupRecord | None:
        """The group of that name, if there is one."""
        found = self.ids.get(name)
        return None if found is None else self.by_id[found]

    def with_channel(self, channel_id: bytes) -> list[GroupRecord]:
        """The groups that a channel is in, in the order of their ids."""
        return [self.by_id[one] for one in sorted(self._ids_with.get(channel_id, ()))]

    def count_with(self, channel_id: bytes) -> int:
        """In how many groups a channel is."""
        return len(self._ids_with.get(channel_id, ()))

    def entries(self) -> Iterator[tuple[bytes, GroupWithWitnesses]]:
        """(id, (group, its witnesses)) in the order of names."""
        return ((one, self._entries[one]) for one in self.ids.values())

    def witnesses_of(self, group: GroupRecord) -> tuple[bytes, ...]:
        """The ids of the hosts that still know its cut, ascending."""
        return self._entries[group.group_id][1]

    def add(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        """Its id and name are new, its members are there."""
        self._link(group, witnesses)
        self._note(ChangeKind.ADDED, group)

    def replace(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        """The group of that id, which keeps its name, is now like this. Who knows its cut is nobody else's business."""
        before, held = self._entries[group.group_id]
        if (group, witnesses) == (before, held):
            return
        if group.spec.channel_ids != before.spec.channel_ids:
            self._unlink_members(before)
            self._link_members(group)
        self._hold(group, witnesses)
        if group != before:
            self._note(ChangeKind.UPDATED, group)

    def remove(self, group: GroupRecord) -> None:
        """Forget a group that is there."""
        self._unlink_members(group)
        del self.by_id[group.group_id]
        del self.ids[group.name]
        del self._entries[group.group_id]
        self._note(ChangeKind.REMOVED, group)

    def _link(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        self.ids[group.name] = group.group_id
        self._hold(group, witnesses)
        self._link_members(group)

    def _hold(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        self.by_id[group.group_id] = group
        self._entries[group.group_id] = (group, witnesses)

    def _link_members(self, group: GroupRecord) -> None:
        for channel_id in group.spec.channel_ids:
            self._ids_with.setdefault(channel_id, set()).add(group.group_id)

    def _unlink_members(self, group: GroupRecord) -> None:
        for channel_id in group.spec.channel_ids:
            held = self._ids_with[channel_id]
            held.discard(group.group_id)
            if not held:
                del self._ids_with[channel_id]
