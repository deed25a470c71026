"""Commands about groups, and their results (paper, section 3.3). Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt_supernode.core.commands import Creation, Operation, Success
from stampede_rt_supernode.core.records import GroupRecord, GroupSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenGroup(Creation):
    """Get or create a group.

    If `spec` is None, an existing group may have any members and settings. A new group gets `new_group_id` and
    `new_incarnation`.
    """

    name: str
    spec: GroupSpec | None
    create: bool
    new_group_id: bytes
    new_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateGroup(Operation):
    """Add and remove members of a group. If `spec_version` is not None, the group must have that version."""

    group_id: bytes
    add_channel_ids: tuple[bytes, ...] = ()
    remove_channel_ids: tuple[bytes, ...] = ()
    spec_version: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class DeleteGroup(Operation):
    """Delete a group."""

    group_id: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupOpened(Success):
    """The group. `created`: this command created it."""

    group: GroupRecord
    created: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupUpdated(Success):
    """The group after the change."""

    group: GroupRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class GroupDeleted(Success):
    """The group `name` is deleted. `name` is empty if the feature level is below FREED_GROUPS_LEVEL."""

    name: str = ""
