"""Adds, lists and removes proxies: read-only copies of channels at other hosts (paper, section 4.1)."""

from __future__ import annotations

from typing import Any

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.copies import bound_at
from stampede_rt._async.discovery import Discovery
from stampede_rt._async.reader import Reader
from stampede_rt._async.session import CALL_TIMEOUT_S, TRY_TIMEOUT_S, request_id
from stampede_rt.errors import HostNotFound, StampedeError
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.v1 import directory_pb2, replica_pb2, subject_pb2
from stampede_rt.v1 import replica_directory_service_pb2 as replicas_pb
from stampede_rt.values.model import Policy
from stampede_rt.values.policy import parse_name
from stampede_rt.values.proxying import ProxyInfo
from stampede_rt.wire.records import proxy_info

BEGIN_TRIES = 4  # each try waits for about 5 s


class Proxies(Discovery):
    """The proxies of channels, by the channel's name or handle. The methods raise ChannelNotFound, Unavailable."""

    async def proxy(self, channel: str | Reader, host: str | None = None, *, source: str | None = None) -> ProxyInfo:
        """Add a proxy of a channel: a read-only copy at another host, which serves readers that accept a copy.

        Returns when the proxy has the items of the channel and serves readers; blocks for up to about 20 s. `host`: the
        host of the proxy; None: the least loaded host. `source`: the host that feeds the proxy, which is the owner or
        the host of another proxy; None: the owner. If the host has a proxy of the channel already, the call waits for
        that proxy. Subscriptions spread over the owner and the proxies by themselves, and gets use proxies if they
        state `max_staleness` or `least_seq`. Raises HostNotFound, ChannelExists if the host owns the channel,
        InvalidArgument if there are 16 copies already, PermissionDenied without the right to configure the channel.
        """
        state = await self._state(channel)
        names = {one.name: one.host_id for one in await self.hosts()} if host or source else {}
        request = replicas_pb.AddReplicaRequest(
            request_id=request_id(),
            subject=subject_pb2.Subject(channel_id=state.info.channel_id),
            epoch=state.info.epoch,
            kind=replica_pb2.REPLICA_KIND_PROXY,
            host_id=_host_id(names, host),
            source_host_id=_host_id(names, source),
        )
        added = await self._session.supernodes.call("AddReplica", request, CALL_TIMEOUT_S)
        await self._begin(state, added.host)
        proxies = {one.host: one for one in await self._list(state)}
        if added.host.name not in proxies:
            raise HostNotFound(f"the proxy of {state.info.name!r} at {added.host.name!r} was removed meanwhile")
        return proxies[added.host.name]

    async def proxies(self, channel: str | Reader) -> list[ProxyInfo]:
        """List the proxies of a channel. A proxy whose host does not answer has `ready` False and no counters."""
        return await self._list(await self._state(channel))

    async def remove_proxy(self, channel: str | Reader, host: str) -> None:
        """Remove the proxy of a channel at a host. Its readers continue at another host, within about 2 s.

        Does nothing if there is no such proxy. Raises HostNotFound, PermissionDenied.
        """
        state = await self._state(channel)
        names = {one.name: one.host_id for one in await self.hosts()}
        request = replicas_pb.RemoveReplicaRequest(
            request_id=request_id(),
            subject=subject_pb2.Subject(channel_id=state.info.channel_id),
            host_id=_host_id(names, host),
        )
        await self._session.supernodes.call("RemoveReplica", request, CALL_TIMEOUT_S)

    async def _state(self, channel: str | Reader) -> ChannelState:
        """Return the state of a channel, with its present epoch."""
        name = channel.name if isinstance(channel, Reader) else parse_name(channel)
        info = await self._session.open_channel(name, Policy(), None, False)
        if not info.host_alive:
            raise HostNotFound(f"the host of channel {name!r} is lost; open the channel, and then try again")
        return self._session.state_of(info, Policy(), False)

    async def _begin(self, state: ChannelState, host: directory_pb2.HostRecord) -> None:
        """Wait until the proxy serves readers. Raises the last error of its host."""
        failure: StampedeError | None = None
        for _ in range(BEGIN_TRIES):
            try:
                await bound_at(self._session, state, host.gatekeepers[0].target, state.info.epoch)
                return
            except StampedeError as error:
                error.concerning("channel", state.info.name)
                failure = error
                if not error.retryable:
                    break
        assert failure is not None, "a try has failed"
        raise failure

    async def _list(self, state: ChannelState) -> list[ProxyInfo]:
        request = replicas_pb.ListReplicasRequest(subject=subject_pb2.Subject(channel_id=state.info.channel_id))
        found = await self._session.supernodes.call("ListReplicas", request, CALL_TIMEOUT_S)
        hosts = {host.host_id: host for host in found.hosts}
        copies = [one for one in found.replicas if one.kind == replica_pb2.REPLICA_KIND_PROXY]
        statuses = [await self._status_at(state, hosts[one.host_id]) for one in copies]
        return [proxy_info(state.info.name, one, hosts, status) for one, status in zip(copies, statuses, strict=True)]

    async def _status_at(self, state: ChannelState, host: directory_pb2.HostRecord) -> Any:
        """Return the status of the copy at a host; None if the host does not answer or has none yet."""
        if not host.alive or not host.gatekeepers:
            return None
        endpoint = self._session.endpoints.to(host.gatekeepers[0].target)
        request = channel_pb.GetChannelStatusRequest(channel_id=state.info.channel_id)
        try:
            response = await endpoint.call(endpoint.channels.GetChannelStatus, request, TRY_TIMEOUT_S)
        except StampedeError:
            return None
        return response.status if response.status.HasField("copy") else None


def _host_id(names: dict[str, bytes], host: str | None) -> bytes:
    """Return the id of a host; empty for None. Raises HostNotFound."""
    if host is None:
        return b""
    name = parse_name(host, "host")
    if name not in names:
        raise HostNotFound(f"there is no host {name!r}; `stampede hosts` lists the hosts")
    return names[name]
