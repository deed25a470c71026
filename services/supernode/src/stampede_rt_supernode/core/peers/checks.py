"""Checks the fields that a peer states, and whether a registration may replace a live peer. Pure."""

from __future__ import annotations

from stampede_rt.errors import InvalidArgument, PermissionDenied, StampedeError, error_for
from stampede_rt.values.peering import ClockOffset
from stampede_rt_supernode.core.peers.commands import RegisterPeer
from stampede_rt_supernode.core.queues.specs import check_queue_spec
from stampede_rt_supernode.core.records import PeerRecord
from stampede_rt_supernode.core.registration_epochs import check_registration_epoch
from stampede_rt_supernode.core.validation import (
    VERSION_CHARACTERS_MAX,
    ZONE_CHARACTERS_MAX,
    check_id,
    check_incarnation,
    check_name,
    check_text,
)

PROOF_BYTES = 32
SHA256_BYTES = 32
ATTRIBUTES_MAX = 32
ATTRIBUTES_BYTES_MAX = 4096
SUPERNODE_ID_CHARACTERS_MAX = 128


def check_proof(proof: bytes) -> None:
    """Check the proof that a peer sends, which is empty if the peer has none. Raises InvalidArgument."""
    if len(proof) not in (0, PROOF_BYTES):
        text = (
            f"proof has {len(proof)} bytes instead of {PROOF_BYTES}; take {PROOF_BYTES} random bytes, or leave it out"
        )
        raise InvalidArgument(text, metadata={"field": "proof"})


def check_clock(clock: ClockOffset | None) -> None:
    """Check the clock report of a peer. Raises InvalidArgument."""
    if clock is None:
        return
    check_text(clock.supernode, "clock.supernode_id", 1, SUPERNODE_ID_CHARACTERS_MAX)
    if clock.uncertainty_nanos < 0:
        text = f"clock.uncertainty_nanos is {clock.uncertainty_nanos}; it is half of a round trip, 0 or more"
        raise InvalidArgument(text, metadata={"field": "clock"})


def check_register_peer(operation: RegisterPeer) -> None:
    """Check the operation without the tables. Raises InvalidName or InvalidArgument."""
    check_id(operation.peer_id, "peer_id")
    check_incarnation(operation.boot_incarnation, "boot_incarnation")
    check_id(operation.new_mailbox_id, "new_mailbox_id")
    check_incarnation(operation.new_incarnation, "new_incarnation")
    check_registration_epoch(operation)
    if len(operation.proof_sha256) not in (0, SHA256_BYTES):
        raise InvalidArgument(f"proof_sha256 has {len(operation.proof_sha256)} bytes instead of {SHA256_BYTES}")
    if operation.host_id is not None:
        check_id(operation.host_id, "host_id")
    _check_mailbox(operation)
    shown = operation.name or operation.peer_id.hex()
    check_text(operation.zone, f"the zone of peer {shown}", 0, ZONE_CHARACTERS_MAX)
    check_text(operation.version, f"the version of peer {shown}", 0, VERSION_CHARACTERS_MAX)
    _check_attributes(shown, operation.attributes)


def _check_mailbox(operation: RegisterPeer) -> None:
    if operation.name:
        check_name(operation.name, "peer")
        if operation.mailbox_host_name:
            check_name(operation.mailbox_host_name, "host")
        if operation.mailbox is not None:
            check_queue_spec(f"of peer {operation.name}", operation.mailbox)
    elif operation.mailbox is not None or operation.mailbox_host_name:
        text = f"peer {operation.peer_id.hex()} states a mailbox, but no name; a mailbox is found by its name: state it"
        raise InvalidArgument(text, metadata={"peer_id": operation.peer_id.hex(), "field": "mailbox"})


def _check_attributes(shown: str, attributes: tuple[tuple[str, str], ...]) -> None:
    used = sum(len(key.encode()) + len(value.encode()) for key, value in attributes)
    if len(attributes) > ATTRIBUTES_MAX or used > ATTRIBUTES_BYTES_MAX:
        raise InvalidArgument(
            f"peer {shown} states {len(attributes)} attributes with {used} bytes; {ATTRIBUTES_MAX} entries with "
            f"{ATTRIBUTES_BYTES_MAX} bytes are the limit",
            metadata={"peer": shown, "field": "attributes"},
        )
    if any(not key for key, _ in attributes):
        text = f"peer {shown} states an attribute without a key; name it"
        raise InvalidArgument(text, metadata={"peer": shown, "field": "attributes"})


def check_may_follow(before: PeerRecord, operation: RegisterPeer) -> None:
    """Check that `operation` may replace a live peer.

    The operation must have the peer's proof. If the peer gave no proof, the operation must have none either, and come
    from the same process. A peer without a name and without a proof needs no protection, so its id is enough. Raises
    PEER_EXISTS, or PermissionDenied if the peer belongs to another caller.
    """
    check_owner(before, operation.owner)
    same_proof = before.proof_sha256 == operation.proof_sha256
    same_process = (before.peer_id, before.boot_incarnation) == (operation.peer_id, operation.boot_incarnation)
    if same_proof and (before.proof_sha256 or same_process or not before.name):
        return
    raise _peer_exists(before)


def check_owner(peer: PeerRecord, owner: str | None) -> None:
    """Check that a caller may act as `peer`.

    `owner`: the caller's name in rules of access; empty if rules do not limit the caller; None if it is unknown. Raises
    PermissionDenied.
    """
    if owner and peer.owner is not None and peer.owner != owner:
        shown = peer.name or peer.peer_id.hex()
        raise PermissionDenied(
            f"peer {shown} belongs to {peer.owner or 'a service or an operator'}, and {owner} may not act for it; "
            "choose another name, or use the credential of its owner",
            metadata={"peer": shown},
        )


def _peer_exists(before: PeerRecord) -> StampedeError:
    shown = before.name or before.peer_id.hex()
    return error_for(
        "PEER_EXISTS",
        f"another live peer has the name {shown}, and the request lacks its proof; take another name, give the proof "
        "with which that peer registered, or wait until it leaves or its lease ends",
        {"peer": shown, "peer_id": before.peer_id.hex()},
    )
