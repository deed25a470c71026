"""What can be done to channels, and what comes of it (paper, section 4.2). Pure, immutable values; see `commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt.values.model import Policy
from stampede_rt_supernode.core.records import Channel, Host


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenChannel:
    """Get or create a channel; `new_channel_id` and `new_incarnation` are used if it is made or placed anew."""

    name: str
    policy: Policy = field(default_factory=Policy)
    create: bool = True
    host_name: str = ""
    new_channel_id: bytes
    new_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateChannel:
    """Change the stated fields of a channel's set-up."""

    channel_id: bytes
    epoch: int
    policy: Policy


@dataclass(frozen=True, kw_only=True, slots=True)
class DeleteChannel:
    """Forget a channel."""

    channel_id: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelOpened:
    """The channel and its owner; `created` by this very command."""

    channel: Channel
    host: Host
    created: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelUpdated:
    """The channel after the change."""

    channel: Channel


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelDeleted:
    """The channel as it was last."""

    channel: Channel
