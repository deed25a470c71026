"""Commands about channels, and their results (paper, section 4.2). Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt.values.model import Policy
from stampede_rt_supernode.core.commands import Creation, Operation, Success
from stampede_rt_supernode.core.records import ChannelRecord, HostRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenChannel(Creation):
    """Get or create a channel. `host_name`: the host that shall own it; empty if the caller does not care.

    `beside`: the name of another channel; empty if the caller names none. The host of that other channel gets the
    opened channel, if the host has room and the opened channel needs an owner.
    A new channel gets `new_channel_id` and `new_incarnation`. If the owner of an existing channel is not alive, the
    channel gets a new owner and `new_incarnation`. `waited_for_index`: the log position of the registration of a host.
    Callers have waited long enough for the archive of this host. 0: there is no such host.
    """

    name: str
    policy: Policy = field(default_factory=Policy)
    create: bool = True
    host_name: str = ""
    beside: str = ""
    new_channel_id: bytes
    new_incarnation: int
    waited_for_index: int = 0


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateChannel(Operation):
    """Change the stated fields of a channel's policy. `epoch`: the present epoch, as the caller knows it."""

    channel_id: bytes
    epoch: int
    policy: Policy


@dataclass(frozen=True, kw_only=True, slots=True)
class DeleteChannel(Operation):
    """Delete a channel."""

    channel_id: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelOpened(Success):
    """The channel and its owner. `created`: this command created it."""

    channel: ChannelRecord
    host: HostRecord
    created: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelUpdated(Success):
    """The channel after the change."""

    channel: ChannelRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelDeleted(Success):
    """The channel as it was before its deletion.

    `freed_groups`: the names of the groups that the directory deleted because the channel was their reference or their
    last member. None if the feature level is below FREED_GROUPS_LEVEL.
    """

    channel: ChannelRecord
    freed_groups: tuple[str, ...] | None = None
