"""What the directory holds: hosts and channels, and what changed. Pure, immutable values.

They are the rows of the four maps of the paper's section 4.3. Ids are 16 opaque bytes.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from stampede_rt.model import Policy

ID_BYTES = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class Endpoint:
    """A gRPC target, and the network or site it is in (empty: none)."""

    target: str
    zone: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Host:
    """A process that hosts channels.

    `name` is unique among the live ones. `channels` is the number of channels that it owns. `registered_index` is the
    log position of its last registration: a lease belongs to one registration, and so does its end.
    """

    host_id: bytes
    name: str
    gatekeepers: tuple[Endpoint, ...]
    boot_incarnation: int
    version: str
    alive: bool
    channels: int
    registered_index: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Channel:
    """A channel and its owner. `epoch` never falls; `incarnation` changes only when items may have been lost."""

    channel_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    policy: Policy
    policy_version: int
    proxy_host_ids: tuple[bytes, ...] = ()


class ChangeKind(Enum):
    """What a change did to its subject."""

    ADDED = "added"
    UPDATED = "updated"
    REMOVED = "removed"


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """One change, at one log position. The subject is as it is after it, or as it was last if it is gone."""

    index: int
    kind: ChangeKind
    subject: Channel | Host
