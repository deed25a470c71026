"""Join tokens: any supernode can make and check them, and no supernode stores them before their use. Pure.

A token contains the time at which it ends, the id of the request that made it, the id of the cluster's log, and a
signature (HMAC, RFC 2104) for one supernode id and one address. The newcomer needs the id of the log for its first
hello. The first leader makes the random key of the signatures. The supernodes keep the key in the directory, and send
it to no caller. The log makes sure that a token lets in only one member.
"""

from __future__ import annotations

import hashlib
import hmac

from stampede_rt.errors import InvalidArgument, PermissionDenied
from stampede_rt_supernode.replication import Member

VALID_NANOS_DEFAULT = 3600 * 10**9
VALID_NANOS_MAX = 24 * 3600 * 10**9
KEY_BYTES = 32
# The parts before the signature: this prefix with the version of the form, the end, the request id, the id of the log.
_PREFIX = "sj3"
_PARTS = 4


class JoinTokens:
    """Makes and checks the tokens of one cluster, whose key is `join_key`."""

    def __init__(self, join_key: bytes) -> None:
        self._join_key = join_key

    def make(self, request_id: bytes, newcomer: Member, *, valid_until_unix_nano: int, log_cluster_id: str) -> str:
        """The token for a request. Equal arguments give equal tokens."""
        body = f"{_PREFIX}.{valid_until_unix_nano:x}.{request_id.hex()}.{log_cluster_id.encode().hex()}"
        return f"{body}.{self._signature(body, newcomer)}"

    def check(self, token: str, newcomer: Member, *, now_unix_nano: int) -> str:
        """Check a token, and return its hash: the ticket by which the log knows it.

        Raises PermissionDenied with reason UNAUTHENTICATED.
        """
        body, _, signature = token.rpartition(".")
        parts = body.split(".")
        is_signed = hmac.compare_digest(signature.encode(), self._signature(body, newcomer).encode())
        if not is_signed or len(parts) != _PARTS:
            raise _refused(
                f"the join token is not one of this cluster for {newcomer.member_id} at {newcomer.address}; make one "
                "with `stampede supernode add`, which prints the whole command"
            )
        if int(parts[1], 16) <= now_unix_nano:
            raise _refused("the join token has ended; make another one with `stampede supernode add`")
        return hashlib.sha256(token.encode()).hexdigest()

    def _signature(self, body: str, newcomer: Member) -> str:
        signed_text = f"stampede-rt join token\n{body}\n{newcomer.member_id}\n{newcomer.address}"
        return hmac.new(self._join_key, signed_text.encode(), hashlib.sha256).hexdigest()


def log_cluster_of(token: str) -> str:
    """The id of the log in a token. Checks no signature. Raises InvalidArgument if the text is not a token."""
    parts = token.split(".")
    try:
        if parts[0] != _PREFIX or len(parts) != _PARTS + 1:
            raise ValueError("wrong form")
        return bytes.fromhex(parts[3]).decode()
    except ValueError as error:
        raise InvalidArgument(
            "--token is not a complete join token; `stampede supernode add` prints the whole command"
        ) from error


def valid_until(now_unix_nano: int, valid_nanos: int | None) -> int:
    """The time at which a token that is made now ends, in Unix nanoseconds.

    The token is valid for `valid_nanos`, or, if that is None, for VALID_NANOS_DEFAULT. Raises InvalidArgument.
    """
    chosen = VALID_NANOS_DEFAULT if valid_nanos is None else valid_nanos
    if not 0 < chosen <= VALID_NANOS_MAX:
        raise InvalidArgument(f"valid_nanos is {chosen}; it must be more than 0 and at most 24 h")
    return now_unix_nano + chosen


def _refused(text: str) -> PermissionDenied:
    return PermissionDenied(text, reason="UNAUTHENTICATED")
