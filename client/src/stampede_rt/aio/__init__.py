"""The names of `stampede_rt` for asyncio. The program awaits each method that blocks in `stampede_rt`."""

from __future__ import annotations

import os as _os
from collections.abc import Generator
from types import TracebackType
from typing import Any

from stampede_rt._async.channel import Channel
from stampede_rt._async.connection import Connection
from stampede_rt._async.cuts import CutSubscription
from stampede_rt._async.group import Group
from stampede_rt._async.group_channel import GroupChannel
from stampede_rt._async.listener import Listener
from stampede_rt._async.matches import MatchSubscription
from stampede_rt._async.message import Message
from stampede_rt._async.presence import Mailbox
from stampede_rt._async.producer import Producer
from stampede_rt._async.queue import Queue
from stampede_rt._async.sampler import Sampler
from stampede_rt._async.session import Session as _Session
from stampede_rt._async.subscription import Subscription
from stampede_rt._async.watch import PeerWatch, Watch
from stampede_rt.cluster.connecting import Target as _Target
from stampede_rt.cluster.connecting import parse_target as _parse_target
from stampede_rt.cluster.embedding import HostOptions as _HostOptions
from stampede_rt.cluster.embedding import InProcessHost as _InProcessHost
from stampede_rt.cluster.embedding import embedder as _embedder
from stampede_rt.security.tls import TlsFiles
from stampede_rt.values.timeline import DurationLike

__all__ = [
    "Channel",
    "Connection",
    "CutSubscription",
    "Group",
    "GroupChannel",
    "Listener",
    "Mailbox",
    "MatchSubscription",
    "Message",
    "PeerWatch",
    "Producer",
    "Queue",
    "Sampler",
    "Subscription",
    "Watch",
    "connect",
    "host",
]


class _Connecting:
    """`await connect(...)` gives the connection; `async with connect(...) as rt` also closes it at the end."""

    def __init__(self, target: _Target, proof: str | None, in_process_host: _InProcessHost | None = None) -> None:
        self._target = target
        self._proof = proof
        self._in_process_host = in_process_host
        self._connection: Connection | None = None

    async def _connect(self) -> Connection:
        target = self._target
        session = _Session(
            target.frontends,
            target.credentials,
            peer_name=target.name,
            zone=target.zone,
            transport=target.transport,
        )
        try:
            self._connection = await Connection(session, target.name, self._proof)._open(self._in_process_host)
        except BaseException:
            await session.aclose()
            raise
        return self._connection

    def __await__(self) -> Generator[Any, None, Connection]:
        return self._connect().__await__()

    async def __aenter__(self) -> Connection:
        return await self._connect()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._connection is not None:
            await self._connection.aclose()


def connect(
    url: str | None = None,
    *,
    name: str | None = None,
    proof: str | None = None,
    secret: str | _os.PathLike[str] | None = None,
    zone: str | None = None,
    tls: TlsFiles | None = None,
    transport: str | None = None,
) -> _Connecting:
    """Like `stampede_rt.connect`. Await it, or enter it with `async with`."""
    return _Connecting(_parse_target(url, name=name, secret=secret, zone=zone, tls=tls, transport=transport), proof)


def host(
    url: str | None = None,
    *,
    name: str | None = None,
    proof: str | None = None,
    secret: str | _os.PathLike[str] | None = None,
    zone: str | None = None,
    tls: TlsFiles | None = None,
    transport: str | None = None,
    listen: str | None = None,
    advertise: str | None = None,
    max_memory: int | str = "1GiB",
    drain: DurationLike = "5s",
    allow_insecure_anywhere: bool = False,
    private: bool = False,
    archive: str | _os.PathLike[str] | None = None,
    archive_folder: str | _os.PathLike[str] | None = None,
    max_archive: int | str | None = None,
) -> _Connecting:
    """Like `stampede_rt.host`. Await it, or enter it with `async with`. The host has a thread of its own."""
    options = _HostOptions.parse(
        listen, advertise, max_memory, drain, allow_insecure_anywhere, private, archive, archive_folder, max_archive
    )
    target = _parse_target(url, name=name, secret=secret, zone=zone, tls=tls, transport=transport)
    return _Connecting(target, proof, _embedder()(target, options))
