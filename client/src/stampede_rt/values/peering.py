"""Participants as others see them (paper, section 4.2). Pure."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import ChangeKind

PROOF_CHARACTERS_MIN = 16


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockOffset:
    """How far a participant's clock is ahead of that of a supernode (negative: behind), as it measured it itself.

    The true offset is at most `uncertainty_nanos` more or less.
    """

    offset_nanos: int
    uncertainty_nanos: int
    supernode: str

    @classmethod
    def measured(
        cls, *, sent_unix_nano: int, took_nanos: int, told_unix_nano: int, supernode: str, held_nanos: int = 0
    ) -> ClockOffset:
        """Of a call that was sent at `sent_unix_nano` by the own clock, in which a supernode told its time.

        It told it at the end of the `held_nanos` for which it had the request. The rest was the way there and back:
        counted as halves, it is wrong by half of it at the most.
        """
        uncertainty = (max(0, took_nanos - held_nanos) + 1) // 2
        return cls(
            offset_nanos=sent_unix_nano + took_nanos - uncertainty - told_unix_nano,
            uncertainty_nanos=uncertainty,
            supernode=supernode,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerInfo:
    """A participant as the directory knows it. `registered` is an instant in nanoseconds since the epoch.

    `clock` is what it told last of its clock; None: unknown. It told nothing (its software is older), or not yet, or
    the leader of the supernodes could not be asked, who alone hears it. Changes that are watched never tell it.
    """

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
    clock: ClockOffset | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerChange:
    """One change among the peers: `kind` is "added", "updated" or "removed"; `peer` is as it is after it."""

    index: int
    kind: ChangeKind
    peer: PeerInfo


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerIdentity:
    """What a participant keeps to itself: its id, and the proof that it is the same one when it comes back."""

    peer_id: bytes
    proof: bytes = field(repr=False)

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
