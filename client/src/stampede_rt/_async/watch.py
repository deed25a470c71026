"""Changes of the directory, as they happen (paper, section 3.5: discovery)."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from stampede_rt._async.directory_client import CONNECT_TIMEOUT_S
from stampede_rt._async.session import Session
from stampede_rt._async.stream_reconnector import StreamReconnector, may_heal
from stampede_rt.errors import StampedeError, Unavailable, WatchRestart
from stampede_rt.handles import BoundToProcess
from stampede_rt.pacing.retry import Backoff
from stampede_rt.transports.concurrency_async import StepLock, StepTask, begin_if_blocking, monotonic_s, sleep
from stampede_rt.transports.streams_async import ServerStream
from stampede_rt.v1 import directory_pb2, directory_service_pb2, peer_service_pb2
from stampede_rt.values.model import Change
from stampede_rt.values.peering import PeerChange
from stampede_rt.values.timeline import DurationLike
from stampede_rt.wire.peers import peer_change
from stampede_rt.wire.records import change

Event = TypeVar("Event")


class DirectoryWatch(BoundToProcess, Generic[Event]):
    """A stream of changes from a supernode. After a break it continues after the last change, from any supernode."""

    def __init__(self, session: Session, request: Any, reconnect: DurationLike | None) -> None:
        self._session = session
        self._reconnecting = StreamReconnector(session, f"the watch of {request.name_glob!r}", reconnect)
        self._cluster_id = session.supernodes.cluster_id
        self._request = request
        self._stream: ServerStream[Any] | None = None
        self._responses: Any = None
        self._ready: deque[Event] = deque()
        self._steps = StepLock()  # callers that step at the same time take turns
        self._step_task = StepTask()
        self._closed = False
        begin_if_blocking(self._open)

    @property
    def reconnects(self) -> int:
        """The number of times that the client has opened the watch again after a break."""
        return self._reconnecting.reconnects

    @property
    def connected(self) -> bool:
        """Whether the watch is open, as last known. False while the client opens it again, and after its end."""
        return self._reconnecting.connected and not self._closed

    def __repr__(self) -> str:
        state = self._session.state or ("closed" if self._closed else "")
        return f"<{type(self).__name__} of {self._request.name_glob!r}{f', {state}' if state else ''}>"

    async def __aenter__(self) -> Self:
        self._session.check_process()
        async with self._steps:
            await self._open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        self._session.check_process()
        async with self._steps:
            while not self._ready or self._closed:
                if self._closed:
                    raise StopAsyncIteration
                await self._step_task.run(self._advance)
            return self._ready.popleft()

    async def _advance(self) -> None:
        await self._open()
        await self._receive()

    def close(self) -> None:
        """End the watch.

        In the blocking client any thread may call this. With asyncio only code on the event loop may call it; other
        code gets WrongEventLoop.
        """
        self._session.check_thread()
        self._closed = True
        self._reconnecting.stop()
        stream = self._stream
        if stream is not None:
            stream.cancel()

    async def _open(self) -> None:
        if self._stream is not None or self._closed:
            return
        try:
            await self._reconnecting.open(self._open_within)
        except StampedeError as error:
            self._closed = not may_heal(error)
            raise

    async def _open_within(self, timeout_s: float) -> None:
        backoff = Backoff(monotonic_s() + timeout_s)
        while self._stream is None and not self._closed:
            try:
                if self._responses is not None:  # the watch was open before
                    await self._check_cluster(backoff.deadline_s)
                await self._open_once()
            except Unavailable:
                delay_s = backoff.next_delay_s(monotonic_s(), 0.5)
                if delay_s is None or self._session.closed:
                    raise
                await sleep(delay_s)

    async def _check_cluster(self, deadline_s: float) -> None:
        """Raise WatchRestart if the supernodes have another cluster id than at the beginning of the watch."""
        if await self._session.supernodes.present_cluster(deadline_s) != self._cluster_id:
            raise WatchRestart("the directory has begun anew, in another cluster; list again, then begin a new watch")

    async def _open_once(self) -> None:
        stream = await self._begin()
        responses = stream.__aiter__()
        try:
            self._take(await responses.__anext__())  # the first response says that the watch is open
        except StampedeError as error:
            self._session.supernodes.demote(stream.target, error)
            raise
        self._stream, self._responses = stream, responses
        if self._closed:  # the program called `close` during the opening
            stream.cancel()

    async def _begin(self) -> ServerStream[Any]:
        raise NotImplementedError

    async def _receive(self) -> None:
        try:
            self._take(await self._responses.__anext__())
        except StopAsyncIteration:
            self._stream = None
        except StampedeError as error:
            self._stream = None
            if not may_heal(error):
                self._closed = True
                raise
            self._reconnecting.broke()

    def _take(self, response: Any) -> None:
        self._ready.extend(self._changes(response))
        self._request.after_index = max(self._request.after_index, response.applied_index)

    def _changes(self, response: Any) -> Iterable[Event]:
        raise NotImplementedError


class Watch(DirectoryWatch[Change]):
    """An iterator over `Change` (see `Connection.watch`), and a context manager. `close` ends the iteration.

    Each step blocks until the next change. After a break the watch continues after the last change, perhaps at another
    supernode. A step raises Unavailable if the client could not reach a supernode for the duration `reconnect`. It
    raises WatchRestart if the supernodes no longer keep the changes since the break, or if the cluster has a new id, as
    after a restore of a backup. After WatchRestart list again, and begin a new watch.
    """

    def __init__(self, session: Session, name_glob: str, reconnect: DurationLike | None) -> None:
        self._hosts: dict[bytes, directory_pb2.HostRecord] = {}
        request = directory_service_pb2.WatchRequest(name_glob=name_glob, include_hosts=True)
        super().__init__(session, request, reconnect)

    async def _begin(self) -> ServerStream[Any]:
        hosts = await self._session.supernodes.call(
            "ListHosts", directory_service_pb2.ListHostsRequest(include_dead=True), CONNECT_TIMEOUT_S
        )
        self._hosts = {host.host_id: host for host in hosts.hosts}
        return self._session.supernodes.stream("Watch", self._request)

    def _changes(self, response: directory_service_pb2.WatchResponse) -> Iterable[Change]:
        for message in response.changes:
            if message.WhichOneof("subject") == "host":
                self._hosts[message.host.host_id] = message.host
            yield change(message, self._hosts)


class PeerWatch(DirectoryWatch[PeerChange]):
    """An iterator over `PeerChange` (see `Connection.watch_peers`), and a context manager.

    Everything else is as in `Watch`.
    """

    def __init__(self, session: Session, name_glob: str, reconnect: DurationLike | None) -> None:
        super().__init__(session, peer_service_pb2.WatchPeersRequest(name_glob=name_glob), reconnect)

    async def _begin(self) -> ServerStream[Any]:
        return self._session.supernodes.stream("WatchPeers", self._request)

    def _changes(self, response: peer_service_pb2.WatchPeersResponse) -> Iterable[PeerChange]:
        return [peer_change(message) for message in response.changes]
