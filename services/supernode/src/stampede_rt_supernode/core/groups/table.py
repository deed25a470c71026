"""The groups of the directory, by id, by name and by member (paper, section 3.3). Pure.

Every edit is atomic and keeps the invariants stated beside the attributes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from sortedcontainers import SortedDict

from stampede_rt_supernode.core.creators import Creators
from stampede_rt_supernode.core.records import ChangeKind, GroupRecord

Note = Callable[[ChangeKind, GroupRecord], None]
GroupWithWitnesses = tuple[GroupRecord, tuple[bytes, ...]]


class GroupTable:
    """The groups. The table calls `note` for every change.

    A witness is a host that owns members and still knows the cut of the present incarnation, because the host has not
    restarted since.
    """

    def __init__(self, entries: Iterable[GroupWithWitnesses], note: Note) -> None:
        self._note = note
        self.by_id: dict[bytes, GroupRecord] = {}
        self.ids: SortedDict[str, bytes] = SortedDict()  # the group's id by its name, for all groups
        self._entries: dict[bytes, GroupWithWitnesses] = {}  # by group id; each with one witness or more, ascending
        self._ids_with: dict[bytes, set[bytes]] = {}  # by channel id; only channels that are in a group
        # By channel id and caller: the number of groups that have the channel, and that the caller has created.
        self._made_with: Counter[tuple[bytes, str]] = Counter()
        self.creators = Creators()
        for group, witnesses in entries:
            self._link(group, witnesses)

    def __len__(self) -> int:
        return len(self.by_id)

    def named(self, name: str) -> GroupRecord | None:
        """The group of that name; None if no group has it."""
        found = self.ids.get(name)
        return None if found is None else self.by_id[found]

    def with_channel(self, channel_id: bytes) -> list[GroupRecord]:
        """The groups of a channel, in the order of their ids."""
        return [self.by_id[one] for one in sorted(self._ids_with.get(channel_id, ()))]

    def count_with(self, channel_id: bytes) -> int:
        """The number of groups to which a channel belongs."""
        return len(self._ids_with.get(channel_id, ()))

    def count_created_with(self, channel_id: bytes, created_by: str) -> int:
        """The number of the groups of a channel that this caller has created."""
        return self._made_with[channel_id, created_by]

    def entries(self) -> Iterator[tuple[bytes, GroupWithWitnesses]]:
        """The (id, (group, its witnesses)) of each group, by name."""
        return ((one, self._entries[one]) for one in self.ids.values())

    def witnesses_of(self, group: GroupRecord) -> tuple[bytes, ...]:
        """The ids of the hosts that still know the group's cut, ascending."""
        return self._entries[group.group_id][1]

    def add(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        """Add a group. Its id and name must be new, and its members must exist."""
        self._link(group, witnesses)
        self._note(ChangeKind.ADDED, group)

    def replace(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        """Replace the group with the same id and name. If only the witnesses change, no change is noted."""
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
        """Delete a group that exists."""
        self._unlink_members(group)
        self.creators.note(group.created_by, -1)
        del self.by_id[group.group_id]
        del self.ids[group.name]
        del self._entries[group.group_id]
        self._note(ChangeKind.REMOVED, group)

    def _link(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        self.ids[group.name] = group.group_id
        self._hold(group, witnesses)
        self._link_members(group)
        self.creators.note(group.created_by, +1)

    def _hold(self, group: GroupRecord, witnesses: tuple[bytes, ...]) -> None:
        self.by_id[group.group_id] = group
        self._entries[group.group_id] = (group, witnesses)

    def _link_members(self, group: GroupRecord) -> None:
        for channel_id in group.spec.channel_ids:
            self._ids_with.setdefault(channel_id, set()).add(group.group_id)
            self._made_with[channel_id, group.created_by] += 1

    def _unlink_members(self, group: GroupRecord) -> None:
        for channel_id in group.spec.channel_ids:
            held = self._ids_with[channel_id]
            held.discard(group.group_id)
            self._made_with[channel_id, group.created_by] -= 1
            if not self._made_with[channel_id, group.created_by]:
                del self._made_with[channel_id, group.created_by]
            if not held:
                del self._ids_with[channel_id]
