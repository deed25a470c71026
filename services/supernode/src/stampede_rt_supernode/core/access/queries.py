"""Queries about rights and quotas, answered from the directory's state. Pure."""

from __future__ import annotations

from functools import lru_cache

from stampede_rt_runtime.access import tokens
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_supernode.core.channels.commands import OpenChannel
from stampede_rt_supernode.core.channels.policies import agree as agree_on_policy
from stampede_rt_supernode.core.groups.commands import OpenGroup
from stampede_rt_supernode.core.queues.commands import OpenQueue
from stampede_rt_supernode.core.queues.specs import agree as agree_on_spec
from stampede_rt_supernode.core.records import PeerRecord
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.tables import Tables

CALLERS_NAMED_MAX = 100


def access_state(directory: DirectoryState) -> AccessState:
    """The facts by which servers judge callers. Has the public half of the token key, not the key that signs."""
    access = directory.access
    return AccessState(
        version=access.version,
        cluster_id=directory.cluster_id,
        rules=access.rules,
        token_keys=(_public_key(access.token_key),) if access.token_key else (),
        revoked_serials=_set_of(access.revoked_serials),
        quotas=access.quotas,
    )


def quota_counts_of_callers(directory: DirectoryState) -> list[tuple[str, Quota, int]]:
    """Counts the channels, queues, groups and peers that callers have created, for the quotas on these numbers.

    Returns triples of caller, quota and count: for each quota the CALLERS_NAMED_MAX callers with the highest counts.
    """
    tables = directory.tables
    counted = {
        Quota.CHANNELS: tables.channel_creators,
        Quota.QUEUES: tables.queues.creators,
        Quota.GROUPS: tables.groups.creators,
        Quota.PEERS: tables.peers.creators,
    }
    return [(name, quota, n) for quota, of in counted.items() for name, n in of.largest(CALLERS_NAMED_MAX)]


def thing_with(tables: Tables, kind: AccessKind, thing_id: bytes) -> str | PeerRecord | None:
    """The name of the thing with that id; for a mailbox, the record of its peer. None if there is no such thing."""
    match kind:
        case AccessKind.CHANNEL:
            channel = tables.channels.get(thing_id)
            return None if channel is None else channel.name
        case AccessKind.GROUP:
            group = tables.groups.by_id.get(thing_id)
            return None if group is None else group.name
        case AccessKind.QUEUE:
            queue = tables.queues.by_id.get(thing_id)
            if queue is None or queue.mailbox_peer_id is None:
                return None if queue is None else queue.name
            return tables.peers.by_id.get(queue.mailbox_peer_id)
        case AccessKind.PEER:
            peer = tables.peers.by_id.get(thing_id)
            return None if peer is None else peer.name


def right_to_open(tables: Tables, operation: OpenChannel | OpenQueue | OpenGroup) -> AccessVerb | None:
    """The right that the open needs, because it creates a thing or changes its settings; None if it does neither."""
    match operation:
        case OpenChannel():
            channel = tables.channel_named(operation.name)
            if channel is None:
                return AccessVerb.CREATE
            changes = agree_on_policy(channel.name, channel.policy, operation.policy) != channel.policy
        case OpenQueue():
            queue = tables.queues.named(operation.name)
            if queue is None:
                return AccessVerb.CREATE
            changes = agree_on_spec(queue.name, queue.spec, operation.spec) != queue.spec
        case OpenGroup():
            return AccessVerb.CREATE if tables.groups.named(operation.name) is None else None
    return AccessVerb.CONFIGURE if changes else None


@lru_cache(4)
def _set_of(serials: tuple[str, ...]) -> frozenset[str]:
    return frozenset(serials)


@lru_cache(4)
def _public_key(token_key: bytes) -> bytes:
    return tokens.public_key(token_key)
