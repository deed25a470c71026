"""Opens, changes and deletes groups in the tables, and applies the loss of channels and hosts to groups. Pure.

As in `channels.transitions`, a function either raises a StampedeError without any change, or succeeds. No function
changes the channels of a group (paper, section 3.3).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from stampede_rt.errors import GroupExists, InvalidArgument, Overloaded
from stampede_rt_runtime.quotas.limits import SHARED_NAMES
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)
from stampede_rt_supernode.core.groups.specs import MEMBERS_MAX, check_spec, same_spec
from stampede_rt_supernode.core.lookups import channel_by_id, group_by_id, no_such_group
from stampede_rt_supernode.core.records import GroupRecord, ReplicaKind
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id, check_incarnation, check_name

GROUPS_MAX = 10_000
GROUPS_PER_CHANNEL_MAX = 1_000  # bounded, because the deletion of a channel changes all its groups in one step
GROUPS_PER_CHANNEL_AND_CALLER_MAX = 750  # fewer, so that other callers can also make groups of the channel


def check_open_group(operation: OpenGroup) -> None:
    """Check the operation without the tables. Raises InvalidName or InvalidArgument."""
    check_name(operation.name, "group")
    check_id(operation.new_group_id, "new_group_id")
    check_incarnation(operation.new_incarnation, "new_incarnation")
    if operation.spec is not None:
        check_spec(operation.name, operation.spec)
    elif operation.create:
        raise InvalidArgument(
            f"group {operation.name} cannot be created without a spec; state its members in spec, or open it with "
            "create=False to take it as it is",
            metadata={"group": operation.name, "field": "spec"},
        )


def check_update_group(operation: UpdateGroup) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.group_id, "group_id")
    for field, ids in (
        ("add_channel_ids", operation.add_channel_ids),
        ("remove_channel_ids", operation.remove_channel_ids),
    ):
        if len(ids) > MEMBERS_MAX:
            text = f"{field} has {len(ids)} channels; a group has at most {MEMBERS_MAX}"
            raise InvalidArgument(text, metadata={"field": field})
        for one in ids:
            check_id(one, field)
    both = set(operation.add_channel_ids) & set(operation.remove_channel_ids)
    if both:
        text = f"channel {min(both).hex()} is in both lists, to add and to remove; leave it out of one"
        raise InvalidArgument(text, metadata={"channel_id": min(both).hex()})


def open_group(tables: Tables, operation: OpenGroup, *, has_shares: bool = True) -> GroupOpened:
    """Get or create a group. `has_shares`: whether GROUPS_PER_CHANNEL_AND_CALLER_MAX is in effect."""
    check_open_group(operation)
    opened = open_group_unchanged(tables, operation)
    return opened if opened is not None else _create(tables, operation, has_shares)


def open_group_unchanged(tables: Tables, operation: OpenGroup) -> GroupOpened | None:
    """The answer to `operation` if the group exists; None if it does not.

    Raises the errors of `open_group`, except errors about its channels and about a lack of room.
    """
    check_open_group(operation)
    group = tables.groups.named(operation.name)
    if group is None:
        if not operation.create:
            raise no_such_group(operation.name)
        return None
    if operation.spec is not None and not same_spec(group.spec, operation.spec):
        raise GroupExists(
            f"group {operation.name} exists with other members or settings; leave them out to take it as it is, add "
            "and remove members, or choose another name",
            metadata={"group": operation.name, "group_id": group.group_id.hex()},
        )
    return GroupOpened(group=group, created=False)


def _create(tables: Tables, operation: OpenGroup, has_shares: bool) -> GroupOpened:
    spec = operation.spec
    assert spec is not None  # check_open_group refuses to create without one
    spec = replace(spec, channel_ids=_members(tables, operation.name, spec.channel_ids))
    if has_shares:
        _check_share(tables, operation.name, operation.created_by, spec.channel_ids)
    tables.groups.creators.check(operation, "groups")
    if len(tables.groups) >= GROUPS_MAX:
        text = f"group {operation.name} cannot be created: the directory holds {GROUPS_MAX} groups, the limit"
        raise Overloaded(f"{text}; delete some", metadata={"group": operation.name})
    group = GroupRecord(
        group_id=operation.new_group_id,
        name=operation.name,
        spec=spec,
        spec_version=1,
        incarnation=operation.new_incarnation,
        created_by=operation.created_by,
    )
    tables.groups.add(group, _hosts_of(tables, group))
    return GroupOpened(group=group, created=True)


def _members(tables: Tables, name: str, channel_ids: Iterable[bytes]) -> tuple[bytes, ...]:
    """The ids of new members. They are the objects of the channels' records, because copies would take much memory.

    Raises ChannelNotFound, and Overloaded if a channel is in too many groups.
    """
    members = []
    for channel_id in channel_ids:
        channel = channel_by_id(tables, channel_id)
        if tables.groups.count_with(channel_id) >= GROUPS_PER_CHANNEL_MAX:
            raise Overloaded(
                f"channel {channel.name} cannot come into group {name}: it is in {GROUPS_PER_CHANNEL_MAX} groups, "
                "the limit; delete some",
                metadata={"group": name, "channel": channel.name},
            )
        members.append(channel.channel_id)
    return tuple(members)


def _check_share(tables: Tables, name: str, created_by: str, channel_ids: Iterable[bytes]) -> None:
    """Check that a caller may create another group with each of these channels. Raises Overloaded.

    A name that several callers share (SHARED_NAMES) has no such limit.
    """
    if not created_by or created_by in SHARED_NAMES:
        return
    for channel_id in channel_ids:
        if tables.groups.count_created_with(channel_id, created_by) >= GROUPS_PER_CHANNEL_AND_CALLER_MAX:
            channel = channel_by_id(tables, channel_id)
            raise Overloaded(
                f"channel {channel.name} cannot come into group {name}: {created_by} has created "
                f"{GROUPS_PER_CHANNEL_AND_CALLER_MAX} groups with that channel, the limit for one caller; delete some",
                metadata={"group": name, "channel": channel.name, "subject": created_by},
            )


def update_group(tables: Tables, operation: UpdateGroup, *, has_shares: bool = True) -> GroupUpdated:
    """Add and remove members. `has_shares`: as for `open_group`.

    The cut stays, unless no owner of a remaining member knows it. Then the group gets a new incarnation. Raises
    InvalidArgument, GroupNotFound, GroupExists, ChannelNotFound or Overloaded.
    """
    check_update_group(operation)
    group = group_by_id(tables, operation.group_id)
    if operation.spec_version is not None and operation.spec_version != group.spec_version:
        raise GroupExists(
            f"group {group.name} has spec version {group.spec_version}, not {operation.spec_version}: "
            "someone has changed it; resolve it again, then decide",
            metadata={"group": group.name, "spec_version": str(group.spec_version)},
        )
    new_members = _members(
        tables,
        group.name,
        [one for one in dict.fromkeys(operation.add_channel_ids) if one not in group.spec.channel_ids],
    )
    if has_shares:
        _check_share(tables, group.name, group.created_by, new_members)
    staying = [one for one in group.spec.channel_ids if one not in operation.remove_channel_ids]
    return GroupUpdated(group=_with_members(tables, group, (*staying, *new_members)))


def _with_members(tables: Tables, group: GroupRecord, channel_ids: tuple[bytes, ...]) -> GroupRecord:
    if channel_ids == group.spec.channel_ids:
        return group
    spec = replace(group.spec, channel_ids=channel_ids)
    check_spec(group.name, spec)
    changed = replace(group, spec=spec, spec_version=group.spec_version + 1)
    return _store_with_witnesses(tables, changed)


def delete_group(tables: Tables, operation: DeleteGroup) -> GroupDeleted:
    """Delete a group, and free its name. Raises GroupNotFound."""
    group = group_by_id(tables, operation.group_id)
    tables.groups.remove(group)
    return GroupDeleted(name=group.name)


def leave_groups(tables: Tables, channel_id: bytes) -> tuple[str, ...]:
    """Remove a channel from its groups, before its deletion. Returns the names of the groups that were deleted.

    If the channel is the reference or the last member of a group, the group is deleted, because its cut could never
    move again.
    """
    freed = []
    for group in tables.groups.with_channel(channel_id):
        staying = tuple(one for one in group.spec.channel_ids if one != channel_id)
        if not staying or group.spec.reference_channel_id == channel_id:
            tables.groups.remove(group)
            freed.append(group.name)
        else:
            _with_members(tables, group, staying)
    return tuple(freed)


def note_lost_cuts(tables: Tables, channel_ids: Iterable[bytes], restarted: bytes | None = None) -> None:
    """Note that these channels have new owners, or that the host `restarted` lost its cuts when it started again.

    A group whose cut no host knows any more gets a new incarnation, see GroupRecord.
    """
    found = {group.group_id for one in channel_ids for group in tables.groups.with_channel(one)}
    for group_id in sorted(found):
        _store_with_witnesses(tables, tables.groups.by_id[group_id], restarted)


def move_witness(tables: Tables, channel_id: bytes, former_host_id: bytes) -> None:
    """If the former owner of the channel knows the cuts of its groups, note that the new owner has taken them over.

    The former owner stays a witness as long as it may become the owner again (see `replicas.transitions.drop_copy`).
    """
    for group in tables.groups.with_channel(channel_id):
        known = {*tables.groups.witnesses_of(group)}
        if former_host_id in known:
            known.add(tables.channels[channel_id].host_id)
        copies = (copy for one in group.spec.channel_ids for copy in tables.replicas.of(one))
        fallbacks = {copy.host_id for copy in copies if copy.kind is ReplicaKind.MOVE}
        tables.groups.replace(group, tuple(sorted(known & {*_hosts_of(tables, group), *fallbacks})))


def _store_with_witnesses(tables: Tables, group: GroupRecord, restarted: bytes | None = None) -> GroupRecord:
    """Store `group` with its remaining witnesses.

    If none is left, its hosts become the witnesses of a new incarnation.
    """
    hosts = _hosts_of(tables, group)
    left = tuple(one for one in tables.groups.witnesses_of(group) if one in hosts and one != restarted)
    if not left:
        # The first incarnation is random, and later ones count up. So the group never had the new one before.
        group, left = replace(group, incarnation=(group.incarnation + 1) % 2**64 or 1), hosts
    tables.groups.replace(group, left)
    return group


def _hosts_of(tables: Tables, group: GroupRecord) -> tuple[bytes, ...]:
    return tuple(sorted({tables.channels[one].host_id for one in group.spec.channel_ids}))
