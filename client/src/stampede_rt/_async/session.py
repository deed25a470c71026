"""The connection behind all handles: it finds the hosts of channels, and tries again when a binding is stale.

A request uses the cached binding. Without a binding the client asks the gatekeeper of the known host. If that fails, it
asks a supernode for the host, and if that fails, a front-end for other supernodes. The client forgets each part that
turns out to be stale (paper, section 4.2).
"""

from __future__ import annotations

import os
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from stampede_rt._async.attempts import attempt
from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.directory_client import CONNECT_TIMEOUT_S, DirectoryClient
from stampede_rt._async.endpoints import EndpointPool, connection_closed
from stampede_rt._async.put_streams import PutStreams
from stampede_rt._async.shared_rings import SharedRings
from stampede_rt.cluster.binding import Binding, BindingCache, Owner
from stampede_rt.cluster.copy_cache import CopyCache
from stampede_rt.cluster.embedding import InProcessHost
from stampede_rt.cluster.tracing import span
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.errors import ChannelNotFound, DeadlineExceeded, StampedeError, Unavailable
from stampede_rt.security.credentials import Credentials
from stampede_rt.transports.concurrency_async import KeyedLock, thread_id
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import channel_pb2, directory_pb2, directory_service_pb2, gatekeeper_service_pb2
from stampede_rt.values.codecs import HandleCodec
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.values.policy import flag_of, parse_name
from stampede_rt.wire.records import channel_info, policy_from_spec, policy_to_spec

CALL_TIMEOUT_S = 10.0  # a call of the program takes at most this time, plus the wait that the program asks for
TRY_TIMEOUT_S = 5.0  # for one request to a host, if the client may ask another one afterwards

Result = TypeVar("Result")


class SessionTask(Protocol):
    """A background task of a connection. It ends with the connection."""

    async def end(self) -> None:
        """End within about a second."""
        ...


def request_id() -> bytes:
    """Return a random id that makes an update safe to repeat."""
    return os.urandom(16)


class Session:
    """The caches of one connection and its retries. All handles of the connection use them."""

    def __init__(
        self,
        frontends: tuple[str, ...],
        credentials: Credentials,
        *,
        peer_name: str,
        zone: str,
        transport: Transport = Transport.GRPC,
        reopening: object | None = None,
    ) -> None:
        self.frontends = frontends
        self.zone = zone
        self._reopening = reopening  # a `ClusterReference`, which opens unpickled handles; None with asyncio
        self.endpoints = EndpointPool(credentials, transport)
        self.check_process = self.endpoints.check_process
        self.supernodes = DirectoryClient(frontends, self.endpoints, peer_name=peer_name, zone=zone)
        self.cache = BindingCache()
        self.copies = CopyCache()
        self.rings = SharedRings(self.endpoints, self.perform, transport)
        self.put_streams = PutStreams()
        self._binding_locks = KeyedLock()
        self.here: InProcessHost | None = None  # the channel host in this process, which belongs to this connection
        self.closing = False  # True from the beginning of `aclose` on
        self.closed = False  # True after `aclose` has ended all tasks
        self.consumer_id = int.from_bytes(os.urandom(8), "little") | 1  # the connection's id as a consumer
        self.consumer_places: dict[bytes, SessionTask] = {}  # by channel id; see `consuming`
        self._attached: dict[SessionTask, None] = {}  # in the order of `attach`

    async def open(self) -> None:
        """Find the supernodes, within 5 s. Raises Unavailable, PermissionDenied, VersionMismatch."""
        await self.supernodes.bind(CONNECT_TIMEOUT_S)

    async def aclose(self) -> None:
        """End all tasks, the latest first, and then all calls.

        In a forked child it only marks the connection as closed, because calls and tasks belong to the parent process.
        """
        if self.inherited:
            self.closed = True
        if self.closing or self.inherited:  # the first caller ends everything
            return
        self.closing = True
        try:
            for one in reversed(tuple(self._attached)):
                await one.end()
        finally:  # also after an interrupt
            self.closed = True
            self.cache.forget_all()
            self.rings.close()
            await self.endpoints.aclose()

    @property
    def inherited(self) -> bool:
        """Whether the connection was made before a fork of this process. It does not work in the child."""
        return self.endpoints.inherited

    @property
    def state(self) -> str:
        """The reason why the connection cannot be used, as a text for people; "" if it can be used."""
        return "of the parent process" if self.inherited else "connection closed" if self.closed else ""

    def reopened(self, kind: str, *arguments: object) -> tuple[Callable[..., object], tuple[object, ...]]:
        """Return the value for `__reduce__` of a handle: the function that opens the handle again, and its arguments.

        Raises TypeError for handles of asyncio.
        """
        if self._reopening is None:
            raise TypeError(
                f"a {kind} of stampede_rt.aio belongs to its event loop and cannot be pickled: pass its name, and open "
                "it there with await"
            )
        return getattr(self._reopening, kind), arguments

    def check_thread(self) -> None:
        """Raise WrongEventLoop unless this thread runs the connection's event loop."""
        self.endpoints.check_thread()

    def check(self) -> None:
        """Raise ForkedProcess, WrongEventLoop, or Unavailable if the connection is closed."""
        self.check_process()
        if self.closed:
            raise connection_closed()

    def attach(self, one: SessionTask) -> None:
        """Keep `one`, so that `aclose` ends it. Raises the errors of `check`."""
        self.check()
        self._attached[one] = None

    def detach(self, one: SessionTask) -> None:
        """Forget `one`, which has ended by itself."""
        self._attached.pop(one, None)

    async def open_channel(
        self,
        name: str,
        policy: Policy,
        host: str | None,
        create: bool,
        timeout_s: float = CALL_TIMEOUT_S,
        *,
        beside: str | None = None,
    ) -> ChannelInfo:
        """Get a channel by name, or create it if `create` is True. Returns its description.

        `beside` is the name of another channel: a new channel should be at the host of that channel. If the lease of
        the channel's owner has ended, the directory gives the channel another owner.
        """
        request = directory_service_pb2.OpenChannelRequest(
            request_id=request_id(),
            name=name,
            spec=policy_to_spec(policy),
            create=flag_of("create", create),
            host_name=parse_name(host, "host") if host else "",
            beside=parse_name(beside) if beside else "",
        )
        with span("open", channel=name):
            response = await self.supernodes.call("OpenChannel", request, timeout_s)
        return self._learn(response.channel, response.host)

    def _learn(self, record: channel_pb2.ChannelRecord, host: directory_pb2.HostRecord) -> ChannelInfo:
        owner = Owner(host_id=record.host_id, epoch=record.epoch, spec_version=record.spec_version)
        self.cache.learn_owner(record.channel_id, owner, [endpoint.target for endpoint in host.gatekeepers])
        return channel_info(record, host)

    def found(self, record: channel_pb2.ChannelRecord, host: directory_pb2.HostRecord | None) -> ChannelState:
        """Return the state of a handle for a channel that the directory listed. The handle creates no channel."""
        info = self._learn(record, host) if host is not None else channel_info(record, None)
        return self.state_of(info, Policy(), False)

    def state_of(
        self, info: ChannelInfo, stated: Policy, create: bool, coding: HandleCodec | None = None
    ) -> ChannelState:
        """Return the state of a new handle."""
        return ChannelState(info, stated, create, coding, self.supernodes.cluster_id)

    async def place(self, state: ChannelState) -> Binding:
        """Return the channel's binding. If the channel has no owner, waits for one, at most 10 s."""

        async def itself(binding: Binding, timeout_s: float) -> Binding:
            return binding

        return await self.perform(state, itself)

    async def perform(
        self,
        state: ChannelState,
        operation: Callable[[Binding, float], Awaitable[Result]],
        timeout_s: float = CALL_TIMEOUT_S,
    ) -> Result:
        """Run `operation` at the channel's host, and again at its new host if the binding is stale.

        `operation`, `timeout_s` and the errors are as in `attempt`.
        """
        return await attempt(ChannelLocator(self, state), operation, timeout_s)

    async def bind(self, state: ChannelState, deadline_s: float = float("inf")) -> Binding:
        """Return the channel's binding, from the cache or from the cluster."""
        found = self.cache.binding(state.info.channel_id, thread_id())
        if found is not None:
            return found
        async with self._binding_locks.hold(state.info.channel_id, left_s(deadline_s)):
            return await self._find(state, deadline_s)

    async def _find(self, state: ChannelState, deadline_s: float) -> Binding:
        found = self.cache.binding(state.info.channel_id, thread_id())
        if found is not None:  # another caller found it meanwhile
            return found
        owner = self.cache.reachable_owner(state.info.channel_id)
        if owner is None:
            await self._resolve(state, deadline_s)
            owner = self.cache.owner(state.info.channel_id)
        if owner is None:
            raise Unavailable(f"the channel {state.info.name!r} has no owner at present; try again soon")
        return await self._bind_at(state, owner, deadline_s)

    async def _resolve(self, state: ChannelState, deadline_s: float) -> None:
        """Ask a supernode for the owner.

        If the owner is lost, open the channel again without a policy, because configure() may have changed the policy
        since the handle was made. If the handle's arguments have `create` False, raise Unavailable.
        """
        timeout_s = left_s(deadline_s)
        request = directory_service_pb2.ResolveChannelRequest(channel_id=state.info.channel_id)
        try:
            response = await self.supernodes.call("ResolveChannel", request, timeout_s)
        except ChannelNotFound:
            await self._resolve_name(state, deadline_s)
            return
        if response.host.alive:
            state.info = self._learn(response.channel, response.host)
            return
        if not state.create:
            name, host = state.info.name, response.host.name or "unknown"
            raise Unavailable(
                f"the host of the recorded channel {name!r} ({host}) is unreachable; start it again with its archive"
                if policy_from_spec(response.channel.spec).is_recorded
                else f"the host of channel {name!r} ({host}) is lost with its items; start the host again, or open the "
                "channel with create=True to have it at another host",
                reason="NO_HOST",
            )
        state.info = await self.open_channel(state.info.name, Policy(), None, False, timeout_s)

    async def _resolve_name(self, state: ChannelState, deadline_s: float) -> None:
        """Open the channel by its name, because the directory does not know its id any more.

        Creates the channel only if the directory itself began anew, for example after the restart of a directory that
        is kept in memory only. Raises ChannelNotFound.
        """
        begun_anew = await self.supernodes.present_cluster(deadline_s) != state.cluster_id
        create = state.create and begun_anew
        state.info = await self.open_channel(state.info.name, state.stated, None, create, left_s(deadline_s))
        state.cluster_id = self.supernodes.cluster_id

    async def _bind_at(self, state: ChannelState, owner: Owner, deadline_s: float) -> Binding:
        request = gatekeeper_service_pb2.BindChannelRequest(
            channel_id=state.info.channel_id,
            epoch=owner.epoch,
            spec_version=owner.spec_version,
            machine=this_machine(),
        )
        failure: StampedeError = Unavailable(
            f"the host of channel {state.info.name!r} has no endpoint; start that host again"
        )
        for target in self.cache.gatekeepers(owner.host_id):
            endpoint = self.endpoints.to(target)
            try:
                response = await endpoint.call(
                    endpoint.gatekeeper.BindChannel, request, min(left_s(deadline_s), TRY_TIMEOUT_S)
                )
            except (Unavailable, DeadlineExceeded) as error:
                about = f"the host {state.info.host!r} of channel {state.info.name!r} at {target}"
                what = "cannot serve the channel" if error.from_service else "cannot be reached"
                failure = Unavailable(f"{about} {what}: {error}", reason=error.reason)
                continue
            return self._bound(state, response)
        raise failure

    def _bound(self, state: ChannelState, response: gatekeeper_service_pb2.BindChannelResponse) -> Binding:
        record = response.channel
        targets = [e.target for e in response.endpoints if e.transport == gatekeeper_service_pb2.TRANSPORT_GRPC]
        if not targets:
            raise Unavailable(
                f"the host of channel {record.name!r} offers no transport that this client has; install the same "
                "release on both"
            )
        binding = Binding(
            subject_id=record.channel_id, target=targets[0], epoch=record.epoch, incarnation=record.incarnation
        )
        self.endpoints.to(binding.target).route.learn(response.endpoints)
        self.cache.learn_binding(binding, thread_id())
        return binding


@dataclass(frozen=True, slots=True)
class ChannelLocator:
    """Finds the binding of a channel."""

    session: Session
    state: ChannelState

    async def find(self, deadline_s: float) -> Binding:
        """Return the channel's binding, from the cache or from the cluster."""
        return await self.session.bind(self.state, deadline_s)

    def is_stale(self, error: StampedeError) -> bool:
        """Whether a service does not know the channel that the cache names. Another channel may have the name."""
        return isinstance(error, ChannelNotFound) and self.session.cache.owner(self.state.info.channel_id) is not None

    def forget(self, error: StampedeError | None = None) -> None:
        """Forget the binding. If `error` names the new owner, learn that owner."""
        self.session.cache.forget(self.state.info.channel_id)
        self.session.cache.follow(self.state.info.channel_id, {} if error is None else error.metadata)

    def check(self) -> None:
        """Raise ForkedProcess, WrongEventLoop, or Unavailable if the connection is closed."""
        self.session.check()

    def explain(self, error: StampedeError) -> None:
        """Add the name of the channel to the error."""
        error.concerning("channel", self.state.info.name)

    @property
    def closed(self) -> bool:
        """Whether the connection is closed."""
        return self.session.closed


def left_s(deadline_s: float) -> float:
    """Return the timeout in seconds of one call that should end by `deadline_s`: 0.1 to CALL_TIMEOUT_S."""
    return max(0.1, min(deadline_s - time.monotonic(), CALL_TIMEOUT_S))
