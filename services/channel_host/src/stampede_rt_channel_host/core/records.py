"""Channels, queues and groups as the directory has recorded them. Pure.

The `message` of a record is the record as the directory encoded it. A host passes `message` on to clients, so that a
client of a newer release gets fields that this release does not know (decision 0113).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.values.model import Policy
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.core.group import GroupDefinition


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedChannel:
    """One channel, with its owner and policy.

    `created_by` is the name of the caller that created the channel. It is empty if the directory does not know the
    caller. `copy_host_ids` are the hosts that hold a copy. `first_incarnation` is the incarnation with which a recorded
    channel began; 0: it is unknown.
    """

    channel_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    spec_version: int
    policy: Policy
    message: bytes = field(repr=False)
    created_by: str = ""
    copy_host_ids: tuple[bytes, ...] = ()
    first_incarnation: int = 0

    @property
    def may_have_lost(self) -> bool:
        """Whether items may have been lost with an earlier owner."""
        return self.epoch > 1 and self.incarnation != self.first_incarnation


def next_incarnation(incarnation: int) -> int:
    """The incarnation that the directory gives to a channel whose new owner continues with the items of a replica.

    The new owner may lack the latest items. An incarnation that begins without items is a random number.
    """
    return (incarnation + 1) % 2**64 or 1


@dataclass(frozen=True, kw_only=True, slots=True)
class PolicyChange:
    """A change of a channel's policy. `stated` has the new values only. `message` is the change as its caller sent it.

    The host passes `message` to the directory. So the directory also checks fields that this host does not know.
    """

    stated: Policy
    message: bytes = field(repr=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedQueue:
    """One queue, with its host and policy.

    A mailbox has no name. `mailbox_peer_name` is the name of its peer. `mailbox_owner` is the caller that registered
    the peer, by the caller's name in rules of access. `created_by` is the name of the caller that created the queue; it
    is empty if the directory does not know the caller.
    """

    queue_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    spec_version: int
    policy: QueuePolicy
    message: bytes = field(repr=False)
    is_mailbox: bool = False
    mailbox_peer_name: str = ""
    mailbox_owner: str = ""
    created_by: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class ResolvedQueue:
    """A queue, and the address of its host as `target`. `target` is None if the host was not alive."""

    queue: RecordedQueue
    target: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedGroup:
    """One group, with its members and settings.

    `created_by` is the name of the caller that created the group. It is empty if the directory does not know the
    caller.
    """

    group_id: bytes
    name: str
    definition: GroupDefinition
    message: bytes = field(repr=False)
    created_by: str = ""

    @property
    def incarnation(self) -> int:
        """The incarnation of the group. Only cuts of the same incarnation can be compared."""
        return self.definition.incarnation

    @property
    def spec_version(self) -> int:
        """The version of the group's spec. It rises with each change of the spec."""
        return self.definition.spec_version


@dataclass(frozen=True, kw_only=True, slots=True)
class ResolvedGroup:
    """A group, its member channels by channel id, and their hosts by host id.

    `targets` has the addresses of the live hosts. `host_names` has the names of all hosts.
    """

    group: RecordedGroup
    channels: Mapping[bytes, RecordedChannel]
    targets: Mapping[bytes, str]
    host_names: Mapping[bytes, str]


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedChange:
    """A change of the directory. It concerns the channel, queue or group whose field is set.

    With `is_of_access` it concerns the rules or keys of access. `removed`: the directory has deleted the thing.
    """

    removed: bool
    channel: RecordedChannel | None = None
    queue: RecordedQueue | None = None
    group_id: bytes | None = None
    is_of_access: bool = False
