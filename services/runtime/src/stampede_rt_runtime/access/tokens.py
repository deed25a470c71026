"""Client tokens: signed by the cluster, for callers that cannot hold a certificate. Pure.

A token contains the cluster, a name, roles, its end and a serial number, and has an Ed25519 signature (RFC 8032). The
supernodes hold the private key in the directory. Hosts and front-ends get only the public key, and can make no tokens.
"""

from __future__ import annotations

import base64
import binascii
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass

from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt.values.policy import NAME_GRAMMAR
from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.identity import Role

KEY_BYTES = 32
TOKEN_CHARACTERS_MAX = 2048
VALID_NANOS_DEFAULT = 3600 * 10**9
VALID_NANOS_MAX = 30 * 24 * 3600 * 10**9
ROLES = (Role.CLIENT, Role.OPERATOR)
_PREFIX = "stampede-token-1."


@dataclass(frozen=True, kw_only=True, slots=True)
class TokenClaims:
    """The contents of a token."""

    cluster_id: str
    name: str
    roles: tuple[Role, ...]
    serial: str
    ends_unix_nano: int

    def caller(self) -> Caller:
        """The caller that brings the token."""
        return Caller(
            kind=CallerKind.TOKEN,
            roles=frozenset(self.roles),
            name=self.name,
            serial=self.serial,
            ends_unix_nano=self.ends_unix_nano,
        )


def check_claims(name: str, roles: Sequence[str], valid_nanos: int) -> tuple[Role, ...]:
    """The roles, ascending. Raises InvalidArgument for values that a token must not have."""
    if re.fullmatch(NAME_GRAMMAR, name) is None:
        raise InvalidArgument(f"the token's name is {name[:64]!r}; allowed: {NAME_GRAMMAR}")
    if not roles or not set(roles) <= set(ROLES):
        raise InvalidArgument(f"the token's roles are {', '.join(roles) or 'none'}; allowed: {', '.join(ROLES)}")
    if not 0 < valid_nanos <= VALID_NANOS_MAX:
        raise InvalidArgument(f"valid_nanos is {valid_nanos}; it must be more than 0 and at most 30 days")
    return tuple(sorted(set(map(Role, roles))))


def public_key(private_key: bytes) -> bytes:
    """The public key for the signatures of `private_key`."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # see the comment in `make_token`

    return Ed25519PrivateKey.from_private_bytes(private_key).public_key().public_bytes_raw()


def make_token(private_key: bytes, claims: TokenClaims) -> str:
    """The token. Equal arguments give equal tokens."""
    # Not at the top: the import takes a tenth of a service's start, and most services never see a token.
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    fields = {
        "cluster": claims.cluster_id,
        "name": claims.name,
        "roles": list(claims.roles),
        "serial": claims.serial,
        "ends": claims.ends_unix_nano,
    }
    body = _PREFIX + _encoded(json.dumps(fields, sort_keys=True, separators=(",", ":")).encode())
    signature = Ed25519PrivateKey.from_private_bytes(private_key).sign(body.encode())
    return f"{body}.{_encoded(signature)}"


def is_token(text: str) -> bool:
    """Whether the text looks like a token."""
    return text.startswith(_PREFIX)


def read_token(text: str, *, keys: Sequence[bytes], cluster_id: str) -> TokenClaims:
    """The contents of a token with a valid signature. Raises PermissionDenied with reason UNAUTHENTICATED."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    body, _, signature = text.rpartition(".")
    if len(text) > TOKEN_CHARACTERS_MAX:
        raise _refused(f"the token has {len(text)} characters; issued tokens have 2048 at most")
    for key in keys:
        try:
            Ed25519PublicKey.from_public_bytes(key).verify(_decoded(signature), body.encode())
        except (InvalidSignature, ValueError):
            continue
        claims = _claims(_decoded(body.removeprefix(_PREFIX)))
        if claims.cluster_id == cluster_id:
            return claims
    raise _refused("this cluster has not signed the token, or a part of the token is missing")


def check_not_over(claims: TokenClaims, *, now_unix_nano: int) -> None:
    """Raises PermissionDenied with reason UNAUTHENTICATED if the token's time has ended."""
    if claims.ends_unix_nano <= now_unix_nano:
        raise _refused(f"the token of {claims.name} has ended")


def _claims(encoded: bytes) -> TokenClaims:
    """The decoded claims. Their form needs no check, because only this cluster signs tokens."""
    fields = json.loads(encoded)
    return TokenClaims(
        cluster_id=fields["cluster"],
        name=fields["name"],
        roles=tuple(map(Role, fields["roles"])),
        serial=fields["serial"],
        ends_unix_nano=fields["ends"],
    )


def _encoded(raw: bytes) -> str:
    return base64.urlsafe_b64encode(raw).decode().rstrip("=")


def _decoded(text: str) -> bytes:
    """The decoded bytes. Raises ValueError."""
    try:
        return base64.b64decode(text + "=" * (-len(text) % 4), altchars=b"-_", validate=True)
    except binascii.Error as error:
        raise ValueError(str(error)) from error


def _refused(what: str) -> PermissionDenied:
    return PermissionDenied(
        f"{what}; ask an operator for another one (stampede token issue NAME)", reason="UNAUTHENTICATED"
    )
