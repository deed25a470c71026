"""The state of the whole cluster, as the page shows it. The server reads it at most once a second, while pages ask."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeVar

from stampede_rt import (
    ChannelInfo,
    ChannelStats,
    GroupInfo,
    HostInfo,
    PeerInfo,
    QueueInfo,
    StampedeError,
    SupernodeInfo,
    aio,
)
from stampede_rt.cli.output import policy_text

COUNTERS_NANOS = 1_000_000_000  # the least time between two reads of counters
LISTS_NANOS = 3_000_000_000  # the least time between two reads of the directory's lists
REST_FACTOR = 5  # after a long read, the server reads nothing for this many times the time that the read took
DETAILS_MAX = 64  # the most groups, and the most queues, whose state the server reads
ROWS_MAX = 2000  # the most channels that one answer lists

Value = TypeVar("Value")


class Overview:
    """Reads lists and counters of a cluster. Reads only channels whose names match `channels_glob`."""

    def __init__(self, channels_glob: str) -> None:
        self._glob = channels_glob
        self._lock = asyncio.Lock()
        self._due = 0
        self._lists_due = 0
        self._answer: dict[str, Any] = {}
        self._notes: list[str] = []
        self._channels: list[ChannelInfo] = []
        self._groups: list[GroupInfo] = []
        self._queues: list[QueueInfo] = []
        self._hosts: list[HostInfo] = []
        self._parts: dict[str, Any] = {}
        self._held_since: dict[str, tuple[tuple[str, ...], int]] = {}
        self._rates: dict[str, tuple[int, int, int]] = {}
        self.stats: dict[str, ChannelStats] = {}

    async def answer(self, rt: aio.Connection) -> dict[str, Any]:
        """Return the state as JSON values. Raises Unavailable if no supernode answers."""
        async with self._lock:
            began = time.time_ns()
            if began >= self._due:
                self._answer = await self._read(rt, began)
                ended = time.time_ns()
                self._due = max(began + COUNTERS_NANOS, ended + REST_FACTOR * (ended - began))
        return self._answer

    async def _read(self, rt: aio.Connection, now: int) -> dict[str, Any]:
        self._notes = []
        if now >= self._lists_due:
            await self._read_lists(rt)
            self._lists_due = now + LISTS_NANOS
        await self._read_counters(rt)
        groups = [await self._group(rt, info) for info in self._groups[:DETAILS_MAX]]
        queues = [await self._queue(rt, info) for info in self._queues[:DETAILS_MAX]]
        return {
            "now": str(time.time_ns()),
            "cluster_id": rt.cluster_id,
            "channels": [self._channel(info, now) for info in self._channels[:ROWS_MAX]],
            "channels_total": len(self._channels),
            "groups": groups,
            "queues": queues,
            "notes": self._notes,
            **self._parts,
        }

    async def _read_lists(self, rt: aio.Connection) -> None:
        self._channels = await rt.channels(self._glob)
        self._hosts = await self._unless_refused("hosts", lambda: rt.hosts(include_dead=True), [])
        self._groups = await self._unless_refused("groups", rt.groups, [])
        self._queues = await self._unless_refused("queues", rt.queues, [])
        peers: list[PeerInfo] = await self._unless_refused("peers", rt.peers, [])
        supernodes: list[SupernodeInfo] = await self._unless_refused("supernodes", rt.supernodes, [])
        names = {info.name for info in self._channels}
        self._rates = {name: rate for name, rate in self._rates.items() if name in names}
        self._parts = {
            "hosts": [_host(info) for info in self._hosts],
            "peers": [
                {"name": one.name, "zone": one.zone, "clock": None if one.clock is None else one.clock.offset_nanos}
                for one in peers
            ],
            "supernodes": [
                {"id": one.supernode_id, "endpoint": one.endpoint, "leader": one.is_leader, "healthy": one.healthy}
                for one in supernodes
            ],
        }

    async def _read_counters(self, rt: aio.Connection) -> None:
        wanted = {info.host for info in self._channels if info.host_alive}
        stats: dict[str, ChannelStats] = {}
        for host in sorted(wanted):
            read = partial(rt.hosted_channels, host, self._glob)
            stats |= await self._unless_refused(f"counters of host {host}", read, dict[str, ChannelStats]())
        self.stats = stats

    async def _unless_refused(self, what: str, read: Callable[[], Awaitable[Value]], otherwise: Value) -> Value:
        """Return the answer of `read`. If it fails, add the reason to the notes of the page, and return `otherwise`."""
        try:
            return await read()
        except StampedeError as error:
            self._notes.append(f"{what}: {error.message}")
            return otherwise

    def _channel(self, info: ChannelInfo, now: int) -> dict[str, Any]:
        row: dict[str, Any] = {
            "name": info.name,
            "host": info.host,
            "alive": info.host_alive,
            "content_type": info.policy.content_type,
            "policy": policy_text(info.policy),
        }
        stats = self.stats.get(info.name)
        if stats is None:
            return row
        rate, bytes_rate = self._rate(info.name, stats)
        return row | {
            "accepted": stats.accepted,
            "held": stats.held,
            "held_bytes": stats.held_bytes,
            "rate": rate,
            "bytes_rate": bytes_rate,
            "newest": _text(stats.newest),
            "oldest": _text(stats.oldest),
            "frontier": _text(stats.frontier),
            "age_nanos": None if stats.newest is None else stats.host_time - stats.newest,
            "subscriptions": stats.subscriptions,
            "waiting_gets": stats.waiting_gets,
            "waiting_puts": stats.waiting_puts,
            "rejected": dict(stats.rejected),
            "collected": dict(stats.collected),
            "consumers": [{"id": one.consumer_id, "waiting": one.waiting} for one in stats.consumers],
        }

    def _rate(self, name: str, stats: ChannelStats) -> tuple[float | None, float | None]:
        """Return the items and the bytes per second since the previous read; (None, None) if they are not known."""
        before = self._rates.get(name)
        self._rates[name] = (stats.host_time, stats.accepted, stats.accepted_bytes)
        if before is None or stats.host_time <= before[0] or stats.accepted < before[1]:
            return None, None
        seconds = (stats.host_time - before[0]) / 1e9
        return (stats.accepted - before[1]) / seconds, (stats.accepted_bytes - before[2]) / seconds

    async def _group(self, rt: aio.Connection, info: GroupInfo) -> dict[str, Any]:
        row: dict[str, Any] = {"name": info.name, "bound": info.bound, "members": [], "cut": None, "waiting_on": []}
        try:
            status = await (await rt.group(info.name)).status()
        except StampedeError as error:
            return row | {"failure": error.message}
        holding = tuple(channel.name for channel in status.waiting_on)
        held, since = self._held_since.get(info.name, (None, 0))
        if held != holding:
            since = status.host_time
            self._held_since[info.name] = (holding, since)
        members = [
            {"name": channel.name, "hidden": one.hidden, "idle": one.idle, "too_short": one.window_too_short}
            for channel, one in status.members.items()
        ]
        return row | {
            "members": members,
            "cut": _text(status.cut),
            "waiting_on": list(holding),
            "since": str(since),
            "host_time": str(status.host_time),
        }

    async def _queue(self, rt: aio.Connection, info: QueueInfo) -> dict[str, Any]:
        row: dict[str, Any] = {"name": info.name, "host": info.host}
        try:
            stats = await (await rt.queue(info.name, create=False)).stats()
        except StampedeError as error:
            return row | {"failure": error.message}
        return row | {
            "held": stats.held,
            "leased": stats.leased,
            "dead_lettered": stats.dead_lettered,
            "dropped": stats.dropped + stats.expelled,
            "consumed": stats.consumed,
            "age_nanos": None if stats.oldest is None else stats.host_time - stats.oldest,
        }


def _host(info: HostInfo) -> dict[str, Any]:
    load = info.load
    return {
        "name": info.name,
        "endpoint": next(iter(info.endpoints), ""),
        "alive": info.alive,
        "channels": info.channels,
        "version": info.version,
        "busy_permille": None if load is None else load.busy_permille,
        "held_bytes": None if load is None else load.held_bytes,
        "bytes_max": None if load is None else load.bytes_max,
    }


def _text(instant: int | None) -> str | None:
    return None if instant is None else str(instant)
