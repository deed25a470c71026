"""Peers, as other programs see them (paper, section 4.2). Pure."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import ChangeKind

PROOF_CHARACTERS_MIN = 16
CLOCKS_APART_NANOS = 5 * 10**9
"""The clocks of the hosts and of the supernodes are at most this far apart."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ClockOffset:
    """How far a peer's clock is ahead of a supernode's (negative: behind), as the peer measured it.

    The true offset differs by at most `uncertainty_nanos`.
    """

    offset_nanos: int
    uncertainty_nanos: int
    supernode: str

    @classmethod
    def measured(
        cls, *, sent_unix_nano: int, took_nanos: int, told_unix_nano: int, supernode: str, held_nanos: int = 0
    ) -> ClockOffset:
        """Return the offset, computed from a call in which a supernode stated its time.

        The peer sent the request at `sent_unix_nano` of its own clock, and got the answer `took_nanos` later. The
        supernode worked on the request for `held_nanos`, and read `told_unix_nano` from its clock at the end of that
        time. The peer assumes that the rest of the round trip took equally long in both directions. The error is at
        most half of that rest.
        """
        uncertainty = (max(0, took_nanos - held_nanos) + 1) // 2
        return cls(
            offset_nanos=sent_unix_nano + took_nanos - uncertainty - told_unix_nano,
            uncertainty_nanos=uncertainty,
            supernode=supernode,
        )

    @property
    def apart_nanos(self) -> int:
        """How far this peer's clock and the clock of a host are apart, at most."""
        return CLOCKS_APART_NANOS + abs(self.offset_nanos) + self.uncertainty_nanos


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerInfo:
    """A peer as the directory knows it. `registered` is an instant in nanoseconds since the epoch.

    `clock` is the peer's last measurement. It is None if the peer has not sent a measurement (a peer of an old release
    never does), if the leader of the supernodes did not answer, or if the record comes from a watch.

    `owner` is the caller that registered the peer, by the name that rules of access use. Only this caller, the services
    of the cluster and operators may renew, replace or end the peer. `owner` is empty if a service or an operator
    registered the peer, and None if the owner is not known.

    `boot_incarnation` is a random number. Each start of the peer's process has a different one.
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
    owner: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerChange:
    """One change of a peer. `kind` is "added", "updated" or "removed".

    `peer` is the peer after the change, or before its removal. `index` is the position of the change in the replicated
    log.
    """

    index: int
    kind: ChangeKind
    peer: PeerInfo


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerIdentity:
    """The id of a peer, and the secret bytes by which the directory recognises the peer after a restart."""

    peer_id: bytes
    proof: bytes = field(repr=False)

    @classmethod
    def parse(cls, name: str, proof: str | None, randomness: bytes) -> PeerIdentity:
        """Return the identity that `name` and the text `proof` give. It is the same in every process.

        If `proof` is None, the two fields come from `randomness` (48 bytes). Raises InvalidArgument if `proof` is no
        text of PROOF_CHARACTERS_MIN characters or more.
        """
        if proof is None:
            return cls(peer_id=randomness[:16], proof=randomness[16:48])
        if not isinstance(proof, str) or len(proof) < PROOF_CHARACTERS_MIN:
            raise InvalidArgument(
                f"the proof of peer {name!r} is no text of {PROOF_CHARACTERS_MIN} characters or more; make one with "
                "secrets.token_hex() and keep it over restarts"
            )
        digest = hashlib.sha512(f"stampede peer {name}\n{proof}".encode()).digest()
        return cls(peer_id=digest[:16], proof=digest[16:48])
