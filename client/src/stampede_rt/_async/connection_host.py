"""The channel host that runs in this process, as its connection sees it (paper, section 4.2)."""

from __future__ import annotations

from stampede_rt._async.queue_locator import open_queue
from stampede_rt._async.session import Session
from stampede_rt.cluster.embedding import START_TIMEOUT_S, InProcessHost
from stampede_rt.errors import ChannelExists, QueueExists
from stampede_rt.transports.concurrency_async import in_thread
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.values.queueing import QueueInfo, QueuePolicy


class ConnectionHost:
    """The host of one connection. It starts with the connection, and ends after all other parts of the connection."""

    def __init__(self, session: Session, host: InProcessHost) -> None:
        self._session = session
        self._host = host

    async def begin(self) -> None:
        """Start the host. Blocks until the directory knows it, for at most about 15 s. Raises StampedeError."""
        self._session.attach(self)
        await in_thread(lambda: self._host.start(START_TIMEOUT_S))
        self._session.here = self._host

    async def end(self) -> None:
        """Move the channels to other hosts, and end the host."""
        await in_thread(self._host.leave)


async def open_channel(
    session: Session, name: str, stated: Policy, host: str | None, create: bool, beside: str | None
) -> ChannelInfo:
    """Open a channel. If this process is a host, and the caller names no place, a new channel goes to this host."""
    if session.here is not None and create and host is None and beside is None:
        try:
            return await session.open_channel(name, stated, session.here.name, create)
        except ChannelExists:  # at another host, or with another policy
            pass
    return await session.open_channel(name, stated, host, create, beside=beside)


async def open_queue_near(
    session: Session, name: str, stated: QueuePolicy, host: str | None, create: bool
) -> QueueInfo:
    """Open a queue. If this process is a host, and the caller names no host, a new queue goes to this host."""
    if session.here is not None and create and host is None:
        try:
            return await open_queue(session, name, stated, session.here.name, create)
        except QueueExists:  # at another host, or with another policy
            pass
    return await open_queue(session, name, stated, host, create)
