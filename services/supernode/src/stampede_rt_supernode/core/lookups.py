"""Finds things of the directory by id or name. Pure. Each function raises an error for a missing thing."""

from __future__ import annotations

from stampede_rt.errors import ChannelNotFound, HostNotFound, StampedeError, error_for
from stampede_rt_supernode.core.records import ChannelRecord, GroupRecord, HostRecord, PeerRecord, QueueRecord
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id, check_name


def channel_by_id(tables: Tables, channel_id: bytes) -> ChannelRecord:
    """The channel of that id. Raises InvalidArgument or ChannelNotFound."""
    check_id(channel_id, "channel_id")
    channel = tables.channels.get(channel_id)
    if channel is None:
        shown = channel_id.hex()
        text = f"there is no channel with the id {shown}; it may have been deleted; resolve it by name"
        raise ChannelNotFound(text, metadata={"channel_id": shown})
    return channel


def channel_by_name(tables: Tables, name: str) -> ChannelRecord:
    """The channel of that name. Raises InvalidName or ChannelNotFound."""
    check_name(name, "channel")
    channel = tables.channel_named(name)
    if channel is None:
        raise no_such_channel(name)
    return channel


def host_by_id(tables: Tables, host_id: bytes) -> HostRecord:
    """The host of that id, alive or not. Raises InvalidArgument or HostNotFound."""
    check_id(host_id, "host_id")
    host = tables.hosts.get(host_id)
    if host is None:
        shown = host_id.hex()
        text = f"there is no host with the id {shown}; it never registered, or it left; register it again"
        raise HostNotFound(text, metadata={"host_id": shown})
    return host


def host_by_name(tables: Tables, name: str) -> HostRecord:
    """The live host of that name. Raises InvalidName or HostNotFound."""
    check_name(name, "host")
    host = tables.live_host_named(name)
    if host is None:
        text = f"there is no live host {name}; it never registered, or its lease has ended; list the hosts"
        raise HostNotFound(text, metadata={"host": name})
    return host


def check_host_agrees(kind: str, name: str, host: HostRecord, asked_host_name: str) -> None:
    """Check that the owner, `host`, is the host that the caller names.

    Raises CHANNEL_EXISTS or QUEUE_EXISTS if it is another host. `kind` is "channel" or "queue". An empty
    `asked_host_name` passes. An owner that is not alive passes, too, because the named host replaces it.
    """
    if host.alive and asked_host_name not in ("", host.name):
        raise StampedeError(
            f"{kind} {name} exists at host {host.name}, not at {asked_host_name}; leave the host out to use it there",
            reason=f"{kind.upper()}_EXISTS",
            metadata={kind: name, "host": host.name},
        )


def no_such_channel(name: str) -> ChannelNotFound:
    """The error for a name that no channel has."""
    text = f"there is no channel {name}; create it with create=True, or list the channels to find its right name"
    return ChannelNotFound(text, metadata={"channel": name})


def group_by_id(tables: Tables, group_id: bytes) -> GroupRecord:
    """The group of that id. Raises InvalidArgument or GROUP_NOT_FOUND."""
    check_id(group_id, "group_id")
    group = tables.groups.by_id.get(group_id)
    if group is None:
        shown = group_id.hex()
        text = f"there is no group with the id {shown}; it may have been deleted; resolve it by name"
        raise StampedeError(text, reason="GROUP_NOT_FOUND", metadata={"group_id": shown})
    return group


def group_by_name(tables: Tables, name: str) -> GroupRecord:
    """The group of that name. Raises InvalidName or GROUP_NOT_FOUND."""
    check_name(name, "group")
    group = tables.groups.named(name)
    if group is None:
        raise no_such_group(name)
    return group


def no_such_group(name: str) -> StampedeError:
    """The error for a name that no group has."""
    text = f"there is no group {name}; name its channels to create it, or list the groups to find its right name"
    return StampedeError(text, reason="GROUP_NOT_FOUND", metadata={"group": name})


def queue_by_id(tables: Tables, queue_id: bytes) -> QueueRecord:
    """The queue or mailbox of that id. Raises InvalidArgument or QUEUE_NOT_FOUND."""
    check_id(queue_id, "queue_id")
    queue = tables.queues.by_id.get(queue_id)
    if queue is None:
        shown = queue_id.hex()
        text = f"there is no queue with the id {shown}; it may have been deleted, or be the mailbox of a peer that left"
        raise error_for("QUEUE_NOT_FOUND", f"{text}: resolve it by name", {"queue_id": shown})
    return queue


def queue_by_name(tables: Tables, name: str) -> QueueRecord:
    """The queue of that name. Raises InvalidName or QUEUE_NOT_FOUND."""
    check_name(name, "queue")
    queue = tables.queues.named(name)
    if queue is None:
        raise no_such_queue(name)
    return queue


def no_such_queue(name: str) -> StampedeError:
    """The error for a name that no queue has."""
    text = f"there is no queue {name}; create it with create=True, or list the queues to find its right name"
    return error_for("QUEUE_NOT_FOUND", text, {"queue": name})


def mailbox_of(tables: Tables, peer_name: str) -> QueueRecord:
    """The mailbox of a live peer. Raises InvalidName or QUEUE_NOT_FOUND."""
    check_name(peer_name, "peer")
    peer = tables.peers.live_named(peer_name)
    if peer is None or peer.mailbox_queue_id is None:
        text = f"there is no mailbox of {peer_name}: no live peer has that name; list the peers"
        raise error_for("QUEUE_NOT_FOUND", text, {"peer": peer_name})
    return tables.queues.by_id[peer.mailbox_queue_id]


def peer_by_id(tables: Tables, peer_id: bytes) -> PeerRecord:
    """The peer of that id, alive or not. Raises InvalidArgument or PEER_NOT_FOUND."""
    check_id(peer_id, "peer_id")
    peer = tables.peers.by_id.get(peer_id)
    if peer is None:
        shown = peer_id.hex()
        text = f"there is no peer with the id {shown}; it never registered, or it left; list the peers"
        raise error_for("PEER_NOT_FOUND", text, {"peer_id": shown})
    return peer


def peer_by_name(tables: Tables, name: str) -> PeerRecord:
    """The live peer of that name. Raises InvalidName or PEER_NOT_FOUND."""
    check_name(name, "peer")
    peer = tables.peers.live_named(name)
    if peer is None:
        text = f"there is no live peer {name}; it never registered, left, or its lease has ended; list the peers"
        raise error_for("PEER_NOT_FOUND", text, {"peer": name})
    return peer
