"""Proxies and moves of channels, as programs see them. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class ProxyInfo:
    """A proxy: a read-only copy of a channel at another host.

    - `source`: the host that feeds the proxy.
    - `ready`: it serves readers. Otherwise it has not caught up yet, has lost its source, or does not answer.
    - `staleness_nanos`: how old its state is at most; None if its host did not answer.
    - `held`: the items that it holds. `missed`: the items that had left the source before it could get them.
    - `waiting`: the items that its source had, as last reported, and that it has not received yet.
    - `subscriptions`: the open subscriptions. `reconnects`: how often its feed was opened again.
    """

    channel: str
    host: str
    source: str
    ready: bool = False
    staleness_nanos: int | None = None
    held: int | None = None
    missed: int | None = None
    waiting: int | None = None
    subscriptions: int | None = None
    reconnects: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class MoveInfo:
    """A channel or queue that has moved to `host`.

    `channel`: its name, also the name of a queue. `held`: the items that moved with it, `held_bytes` their payload
    bytes. `blackout_nanos`: the time for which puts waited; 0 if the channel was there already.
    """

    channel: str
    host: str
    held: int
    held_bytes: int
    blackout_nanos: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DrainInfo:
    """A host whose channels, queues and mailboxes were to move to other hosts.

    `moved`: the number of those that have moved. `left`: those that have not moved, by name, with the reasons; at most
    1000 of `left_count`.
    """

    host: str
    moved: int
    left: Mapping[str, str]
    left_count: int


@dataclass(frozen=True, kw_only=True, slots=True)
class CopyStats:
    """A copy of a channel, as the host that feeds it sees it.

    `waiting`: the items that the host has not sent yet. `subscriptions`: as the copy last reported them. `ready`: the
    copy serves readers. `replica`: it is a replica, which serves no readers and becomes the owner if the owner is lost
    while the replica is `in_sync`. `heard_ago_nanos`: the time since the copy last sent a message.
    """

    host_id: bytes
    waiting: int
    subscriptions: int
    ready: bool
    replica: bool = False
    in_sync: bool = False
    heard_ago_nanos: int = 0
