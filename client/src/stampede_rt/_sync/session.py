# Generated from ../_async by tools/generate.py; do not edit.
"""One participant's link to the cluster: resolves channels, binds to their hosts, tries again when a place is stale.

A request takes the cached data endpoint; a miss asks the host's gatekeeper; a miss there asks a supernode; all
supernodes gone, the front-end. What fails as stale is forgotten and counts as a miss (paper, section 4.2).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

from stampede_rt._sync.attempts import attempt
from stampede_rt._sync.directory_client import CONNECT_TIMEOUT_S, DirectoryClient
from stampede_rt._sync.endpoints import EndpointPool
from stampede_rt._sync.put_streams import PutStreams
from stampede_rt.cluster.binding import Binding, BindingCache, Owner
from stampede_rt.errors import ChannelNotFound, DeadlineExceeded, StampedeError, Unavailable
from stampede_rt.security.credentials import Credentials
from stampede_rt.transports.concurrency_sync import KeyedLock, thread_id
from stampede_rt.v1 import channel_pb2, directory_pb2, directory_service_pb2, gatekeeper_service_pb2
from stampede_rt.values.codecs import Coding
from stampede_rt.values.model import ChannelInfo, Policy
from stampede_rt.values.policy import flag_of, parse_name
from stampede_rt.wire.records import channel_info, policy_to_spec
from stampede_rt.wire.runs import ItemDecoder

CALL_TIMEOUT_S = 10.0
TRY_TIMEOUT_S = 5.0

Result = TypeVar("Result")


class SessionTask(Protocol):
    """What works in the background of a connection, and ends with it."""

    def end(self) -> None:
        """Let go of what it holds, within a second or so."""
        ...


def request_id() -> bytes:
    """What makes an update safe to repeat."""
    return os.urandom(16)


@dataclass(slots=True)
class ChannelState:
    """What a handle knows of its channel; `info` follows the directory. `cluster_id`: where `info` comes from."""

    info: ChannelInfo
    stated: Policy
    create: bool
    coding: Coding | None = None
    cluster_id: str = ""

    def decoder(self, incarnation: int, *, payloads: bool) -> ItemDecoder:
        """What makes Items of the runs that the host sends."""
        policy = self.info.policy
        return ItemDecoder(
            incarnation=incarnation,
            content_type=policy.content_type or "",
            payloads=payloads,
            coding=self.coding,
            overlap_nanos=policy.overlap_nanos or 0,
        )


class Session:
    """The caches and the retries behind every handle of one connection."""

    def __init__(
        self,
        frontends: tuple[str, ...],
        credentials: Credentials,
        *,
        peer_name: str,
        zone: str,
        reopening: object | None = None,
    ) -> None:
        self.frontends = frontends
        self.zone = zone
        self._reopening = reopening
        self.endpoints = EndpointPool(credentials)
        self.supernodes = DirectoryClient(frontends, self.endpoints, peer_name=peer_name, zone=zone)
        self.cache = BindingCache()
        self.put_streams = PutStreams()
        self._binding_locks = KeyedLock()
        self.closing = False
        self.closed = False
        self.consumer_id = int.from_bytes(os.urandom(8), "little") | 1  # who the connection is where items are consumed
        self.consumer_places: dict[bytes, SessionTask] = {}  # that it keeps, by channel id; see `consuming`
        self._attached: dict[SessionTask, None] = {}  # in the order of their coming

    def open(self) -> None:
        """Find the supernodes, within 5 s. Raises Unavailable, PermissionDenied, VersionMismatch."""
        self.supernodes.bind(CONNECT_TIMEOUT_S)

    def close(self) -> None:
        """End everything that is under way, the latest first. In a forked child it is the parent's, and goes on."""
        if self.inherited:
            self.closed = True
        if self.closing or self.inherited:  # whoever began it ends it: what takes its leave is not cut off meanwhile
            return
        self.closing = True
        try:
            for one in reversed(tuple(self._attached)):
                one.end()
        finally:  # also when somebody loses patience meanwhile
            self.closed = True
            self.cache.forget_all()
            self.endpoints.close()

    @property
    def inherited(self) -> bool:
        """The connection was made before this process was forked, and is of no use in it."""
        return self.endpoints.inherited

    @property
    def state(self) -> str:
        """What keeps the connection from being used, for people; "" if nothing does."""
        return "of the parent process" if self.inherited else "connection closed" if self.closed else ""

    def reopened(self, kind: str, *arguments: object) -> tuple[Callable[..., object], tuple[object, ...]]:
        """What pickle writes for a handle of this connection: how another process opens it. Raises TypeError."""
        if self._reopening is None:
            raise TypeError(
                f"a {kind} of stampede_rt.aio belongs to its event loop and cannot be pickled: pass its name, and open "
                "it there with await"
            )
        return getattr(self._reopening, kind), arguments

    def check_process(self) -> None:
        """Raises ForkedProcess if the connection is inherited."""
        self.endpoints.check_process()

    def check(self) -> None:
        """Raises ForkedProcess, or Unavailable if the connection is closed."""
        self.check_process()
        if self.closed:
            raise connection_closed()

    def attach(self, one: SessionTask) -> None:
        """End `one` before the connection is closed."""
        self.check()
        self._attached[one] = None

    def detach(self, one: SessionTask) -> None:
        """It has ended by itself."""
        self._attached.pop(one, None)

    def open_channel(
        self, name: str, policy: Policy, host: str | None, create: bool, timeout_s: float = CALL_TIMEOUT_S
    ) -> ChannelInfo:
        """Get or create a channel by name; an owner whose lease has ended is replaced."""
        request = directory_service_pb2.OpenChannelRequest(
            request_id=request_id(),
            name=name,
            spec=policy_to_spec(policy),
            create=flag_of("create", create),
            host_name=parse_name(host, "host") if host else "",
        )
        response = self.supernodes.call("OpenChannel", request, timeout_s)
        return self._learn(response.channel, response.host)

    def _learn(self, record: channel_pb2.ChannelRecord, host: directory_pb2.HostRecord) -> ChannelInfo:
        owner = Owner(host_id=record.host_id, epoch=record.epoch, spec_version=record.spec_version)
        self.cache.learn_owner(record.channel_id, owner, [endpoint.target for endpoint in host.gatekeepers])
        return channel_info(record, host)

    def found(self, record: channel_pb2.ChannelRecord, host: directory_pb2.HostRecord | None) -> ChannelState:
        """What a handle knows of a channel that the directory told of unasked; it may not create the channel anew."""
        info = self._learn(record, host) if host is not None else channel_info(record, None)
        return self.state_of(info, Policy(), False)

    def state_of(self, info: ChannelInfo, stated: Policy, create: bool, coding: Coding | None = None) -> ChannelState:
        """What a new handle knows of a channel."""
        return ChannelState(info, stated, create, coding, self.supernodes.cluster_id)

    def place(self, state: ChannelState) -> Binding:
        """Where the channel's data is; waits a while for an owner if it has none."""

        def itself(binding: Binding) -> Binding:
            return binding

        return self.perform(state, itself)

    def perform(
        self,
        state: ChannelState,
        operation: Callable[[Binding], Result],
        timeout_s: float | None = CALL_TIMEOUT_S,
    ) -> Result:
        """Run `operation` at the channel's host, and again at its new place if this one is stale or gone.

        `timeout_s` bounds the trying, not a wait inside `operation`; None: for ever. Raises what the last try met.
        """
        return attempt(ChannelLocator(self, state), operation, timeout_s)

    def bind(self, state: ChannelState, deadline_s: float = float("inf")) -> Binding:
        """Where the channel's data is, from the caches or by asking."""
        found = self.cache.binding(state.info.channel_id, thread_id())
        if found is not None:
            return found
        with self._binding_locks.hold(state.info.channel_id, left_s(deadline_s)):
            return self._find(state, deadline_s)

    def _find(self, state: ChannelState, deadline_s: float) -> Binding:
        found = self.cache.binding(state.info.channel_id, thread_id())
        if found is not None:  # by now
            return found
        owner = self.cache.owner(state.info.channel_id)
        if owner is None:
            self._resolve(state, deadline_s)
            owner = self.cache.owner(state.info.channel_id)
        if owner is None:
            raise Unavailable(f"the channel {state.info.name!r} has no owner at present")
        return self._bind_at(state, owner, deadline_s)

    def _resolve(self, state: ChannelState, deadline_s: float) -> None:
        """Ask a supernode who owns the channel; one whose owner is lost is opened anew, as its handle was."""
        timeout_s = left_s(deadline_s)
        request = directory_service_pb2.ResolveChannelRequest(channel_id=state.info.channel_id)
        try:
            response = self.supernodes.call("ResolveChannel", request, timeout_s)
        except ChannelNotFound:
            self._resolve_name(state, deadline_s)
            return
        if response.host.alive:
            state.info = self._learn(response.channel, response.host)
            return
        if not state.create:
            raise Unavailable(
                f"the host of channel {state.info.name!r} ({response.host.name or 'unknown'}) is lost, and what "
                "it held with it; this handle only looks: start the host again, or have another one take the channel, "
                "as whoever opens it with create=True does",
                reason="NO_HOST",
            )
        state.info = self.open_channel(state.info.name, state.stated, None, True, timeout_s)

    def _resolve_name(self, state: ChannelState, deadline_s: float) -> None:
        """The channel's id is not known any more: whoever has its name now is meant.

        If nobody has, it was deleted; unless the whole directory began anew, as it does in memory: then it is opened as
        its handle was. Raises ChannelNotFound.
        """
        begun_anew = self.supernodes.present_cluster(deadline_s) != state.cluster_id
        create = state.create and begun_anew
        state.info = self.open_channel(state.info.name, state.stated, None, create, left_s(deadline_s))
        state.cluster_id = self.supernodes.cluster_id

    def _bind_at(self, state: ChannelState, owner: Owner, deadline_s: float) -> Binding:
        request = gatekeeper_service_pb2.BindChannelRequest(
            channel_id=state.info.channel_id, epoch=owner.epoch, spec_version=owner.spec_version
        )
        failure: StampedeError = Unavailable(f"the host of channel {state.info.name!r} has no endpoint")
        for target in self.cache.gatekeepers(owner.host_id):
            endpoint = self.endpoints.to(target)
            try:
                response = endpoint.call(
                    endpoint.gatekeeper.BindChannel, request, min(left_s(deadline_s), TRY_TIMEOUT_S)
                )
            except (Unavailable, DeadlineExceeded) as error:
                failure = Unavailable(
                    f"the host {state.info.host!r} of channel {state.info.name!r} at {target} cannot be reached: "
                    f"{error}",
                    reason=error.reason,
                )
                continue
            return self._bound(state, response)
        raise failure

    def _bound(self, state: ChannelState, response: gatekeeper_service_pb2.BindChannelResponse) -> Binding:
        record = response.channel
        targets = [e.target for e in response.endpoints if e.transport == gatekeeper_service_pb2.TRANSPORT_GRPC]
        if not targets:
            raise Unavailable(f"the host of channel {record.name!r} offers no transport that this client has")
        binding = Binding(
            subject_id=record.channel_id, target=targets[0], epoch=record.epoch, incarnation=record.incarnation
        )
        self.cache.learn_binding(binding, thread_id())
        return binding


@dataclass(frozen=True, slots=True)
class ChannelLocator:
    """Where a channel is, as far as a session knows."""

    session: Session
    state: ChannelState

    def find(self, deadline_s: float) -> Binding:
        """The cached data endpoint, or one found anew."""
        return self.session.bind(self.state, deadline_s)

    def forget(self) -> None:
        """Forget the channel's place, and its host's endpoint."""
        self.session.cache.forget(self.state.info.channel_id)

    def check(self) -> None:
        """Raises what keeps the connection from being used."""
        self.session.check()

    def explain(self, error: StampedeError) -> None:
        """Name the channel."""
        error.concerning("channel", self.state.info.name)

    @property
    def closed(self) -> bool:
        """The connection is closed."""
        return self.session.closed


def connection_closed() -> Unavailable:
    """What every call meets whose connection is closed, before it begins or while it waits."""
    return Unavailable("this connection is closed; connect() again")


def left_s(deadline_s: float) -> float:
    """How long one call may take that is to be over by `deadline_s`."""
    return max(0.1, min(deadline_s - time.monotonic(), CALL_TIMEOUT_S))
