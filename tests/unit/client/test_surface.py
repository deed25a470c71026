"""The public surface: every RPC for callers has a method, and both clients have the same names with docstrings."""

from __future__ import annotations

import inspect
import typing

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.v1 import (
    channel_service_pb2,
    directory_service_pb2,
    frontend_service_pb2,
    gatekeeper_service_pb2,
    group_directory_service_pb2,
    group_service_pb2,
    peer_service_pb2,
    queue_directory_service_pb2,
    queue_service_pb2,
)

METHODS = {
    "Bind": st.connect,
    "OpenChannel": st.Connection.channel,
    "ResolveChannel": st.Channel.put,  # and every other call of a handle whose place is not cached
    "ListChannels": st.Connection.channels,
    "ListHosts": st.Connection.hosts,
    "ResolveHost": st.Connection.hosted_channels,
    "ListHostedChannels": st.Connection.hosted_channels,
    "ListSupernodes": st.Connection.supernodes,
    "Watch": st.Connection.watch,
    "DeleteChannel": st.Channel.delete,
    "BindChannel": st.Channel.put,
    "DropChannel": st.Channel.delete,
    "ConfigureChannel": st.Channel.configure,
    "Put": st.Channel.put,
    "Get": st.Channel.get,
    "Subscribe": st.Channel.subscribe,
    "Advance": st.Channel.advance,
    "Consume": st.Channel.consume,
    "GetChannelStatus": st.Channel.stats,
    "OpenGroup": st.Connection.group,
    "ResolveGroup": st.Group.refresh,
    "UpdateGroup": st.Group.add,
    "DeleteGroup": st.Group.delete,
    "ListGroups": st.Connection.groups,
    "GetCut": st.Group.get,
    "SubscribeCuts": st.Group.subscribe,
    "SubscribeMatches": st.Group.match,
    "GetGroupStatus": st.Group.status,
    "OpenQueue": st.Connection.queue,
    "ResolveQueue": st.Connection.send,  # and every other call of a queue's handle whose place is not cached
    "UpdateQueue": st.Queue.configure,
    "DeleteQueue": st.Queue.delete,
    "ListQueues": st.Connection.queues,
    "Enqueue": st.Queue.put,
    "Take": st.Queue.get,
    "Settle": st.Message.ack,
    "ListPending": st.Queue.pending,
    "GetQueueStatus": st.Queue.stats,
    "RegisterPeer": st.connect,
    "RenewPeerLease": st.connect,
    "DeregisterPeer": st.Connection.close,
    "ResolvePeer": st.Connection.peer,
    "ListPeers": st.Connection.peers,
    "WatchPeers": st.Connection.watch_peers,
}
# Calls of hosts to supernodes, and to each other.
OF_SERVICES = {"RegisterHost", "RenewHostLease", "DeregisterHost", "UpdateChannel", "ExchangeTimes"}
# Calls that measure round trips, or find the addresses of sockets.
OF_CONNECTIONS = {"Ping", "ListDataEndpoints", "ShareMemory"}


def test_every_rpc_for_callers_has_a_method() -> None:
    modules = (
        channel_service_pb2,
        directory_service_pb2,
        frontend_service_pb2,
        gatekeeper_service_pb2,
        group_directory_service_pb2,
        group_service_pb2,
        peer_service_pb2,
        queue_directory_service_pb2,
        queue_service_pb2,
    )
    services = [service for module in modules for service in module.DESCRIPTOR.services_by_name.values()]
    rpcs = {method.name for service in services for method in service.methods}
    assert rpcs == set(METHODS) | OF_SERVICES | OF_CONNECTIONS
    assert all(callable(method) and method.__doc__ for method in METHODS.values())


@pytest.mark.parametrize(
    "name",
    [
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
    ],
)
def test_both_clients_have_the_same_names_and_arguments(name: str) -> None:
    blocking, awaited = getattr(st, name), getattr(aio, name)
    names = {one for one in dir(blocking) if not one.startswith("_")}
    assert names == {one.replace("aclose", "close") for one in dir(awaited) if not one.startswith("_")}
    for one in names - {"close"}:
        if callable(getattr(blocking, one)):
            mine, theirs = (inspect.signature(getattr(cls, one)).parameters for cls in (blocking, awaited))
            assert mine.keys() == theirs.keys(), one


@pytest.mark.parametrize(
    "owner",
    [
        st,
        aio,
        st.Channel,
        st.Connection,
        st.Producer,
        st.Subscription,
        st.Watch,
        st.Items,
        st.Queue,
        st.Mailbox,
        st.Message,
        st.Listener,
        st.Sampler,
    ],
)
def test_everything_public_has_a_docstring(owner: object) -> None:
    for name in getattr(owner, "__all__", vars(owner)):
        value = getattr(owner, name)
        # A value with an origin is an alias of types for annotations, and can have no docstring.
        if not name.startswith("_") and callable(value) and typing.get_origin(value) is None:
            assert value.__doc__, name
