"""The rows of peers in the command table. Pure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stampede_rt_supernode.core.cluster.feature_levels import GROUPS_AND_PEERS_LEVEL, OWNERS_LEVEL
from stampede_rt_supernode.core.command_kinds import CommandKind
from stampede_rt_supernode.core.peers.checks import check_register_peer
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerDeregistered,
    PeerRegistered,
    PeersExpired,
    RegisterPeer,
)
from stampede_rt_supernode.core.peers.transitions import deregister_peer, expire_peers, register_peer
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.validation import check_id


def _register(state: DirectoryState, operation: RegisterPeer, time_unix_nano: int) -> PeerRegistered:
    state.check_founded()
    if state.feature_level < OWNERS_LEVEL:
        operation = replace(operation, owner=None)
    if state.feature_level < GROUPS_AND_PEERS_LEVEL:
        operation = replace(operation, created_by="", created_max=None)
    return register_peer(state.tables, operation, time_unix_nano, state.cluster_id)


def _deregister(state: DirectoryState, operation: DeregisterPeer, time_unix_nano: int) -> PeerDeregistered:
    deregister_peer(state.tables, operation)
    return PeerDeregistered()


def _expire(state: DirectoryState, operation: ExpirePeers, time_unix_nano: int) -> PeersExpired:
    return PeersExpired(expired=expire_peers(state.tables, operation, state.tenure))


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=RegisterPeer,
        result=PeerRegistered,
        feature_level=1,
        subject=lambda one: one.peer_id.hex(),
        check=check_register_peer,
        apply=_register,
    ),
    CommandKind(
        operation=DeregisterPeer,
        result=PeerDeregistered,
        feature_level=1,
        subject=lambda one: one.peer_id.hex(),
        check=lambda one: check_id(one.peer_id, "peer_id"),
        apply=_deregister,
    ),
    CommandKind(
        operation=ExpirePeers,
        result=PeersExpired,
        feature_level=1,
        subject=lambda one: f"{one.tenure} {len(one.leases)}",
        apply=_expire,
        needs_room=False,
    ),
)
