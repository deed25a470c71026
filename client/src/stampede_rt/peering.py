"""Participants as others see them (paper, section 4.2). Pure."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

from stampede_rt.errors import InvalidArgument

PROOF_CHARACTERS_MIN = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerInfo:
    """A participant as the directory knows it. `registered` is an instant in nanoseconds since the epoch."""

    peer_id: bytes
    name: str
    alive: bool
    boot_incarnation: int
    mailbox_queue_id: bytes | None
    host_id: bytes | None
    zone: str
    version: str
    attributes: Mapping[str, str]
    registered: int


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerChange:
    """One change among the peers: `kind` is "added", "updated" or "removed"; `peer` is as it is after it."""

    index: int
    kind: str
    peer: PeerInfo


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerIdentity:
    """What a participant keeps to itself: its id, and the proof that it is the same one when it comes back."""

    peer_id: bytes
    proof: bytes

    @classmethod
    def parse(cls, name: str, proof: str | None, randomness: bytes) -> PeerIdentity:
        """From a caller's secret text, the same identity every time; without one from 48 random bytes."""
        if proof is None:
            return cls(peer_id=randomness[:16], proof=randomness[16:48])
        if not isinstance(proof, str) or len(proof) < PROOF_CHARACTERS_MIN:
            raise InvalidArgument(
                f"the proof of peer {name!r} is no text of {PROOF_CHARACTERS_MIN} characters or more; make one with "
                "secrets.token_hex() and keep it over restarts"
            )
        digest = hashlib.sha512(f"stampede peer {name}\n{proof}".encode()).digest()
        return cls(peer_id=digest[:16], proof=digest[16:48])
