"""The errors of callers without a right, or without a valid credential."""

from __future__ import annotations

from stampede_rt.errors import PermissionDenied, StampedeError, Unavailable
from stampede_rt_runtime.access.caller import Caller, CallerKind
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb


def denied(caller: Caller, verb: AccessVerb, kind: AccessKind, name: str) -> PermissionDenied:
    """The error for a caller without that right."""
    return PermissionDenied(
        f"{caller} may not {verb} {kind} {name}; {_way_out(caller, verb, kind, name)}",
        metadata={"verb": verb, kind: name},
    )


def denied_all(caller: Caller, kind: AccessKind, name: str = "") -> PermissionDenied:
    """The error for a caller without any right to the thing.

    `name` must be empty if the caller gave only an id: the error must not show a name that the caller may not know.
    """
    thing, placeholder = (f"{kind} {name}", name) if name else (f"this {kind}", "NAME")
    return PermissionDenied(f"{caller} may do nothing with {thing}; {_way_out(caller, 'VERB', kind, placeholder)}")


def _way_out(caller: Caller, verb: str, kind: AccessKind, name: str) -> str:
    """The advice to a caller without a right. The advice does not show whether a rule denies the right."""
    return (
        f"an operator can allow it (stampede acl add {caller.name} {verb} {name} --kind {kind}), unless a rule denies "
        "it (stampede acl ls)"
    )


def over(caller: Caller) -> StampedeError:
    """The error for a credential that ended during a call, or after it had opened the connection.

    The caller should try again, because it reads renewed certificates and tokens from its files. A call that brings an
    ended token is refused for ever, see `check_not_over`.
    """
    if caller.kind is CallerKind.CERTIFICATE:
        text = f"the certificate of {caller} has expired; renew it (stampede certs renew), and connect again"
        return Unavailable(text, reason="CERTIFICATE_EXPIRED")
    text = f"the {caller.kind} of {caller} has ended; call again with a new one (stampede token issue {caller.name})"
    return Unavailable(text, reason="TOKEN_EXPIRED")


def revoked(caller: Caller) -> PermissionDenied:
    """The error for a credential that was revoked."""
    text = f"the {caller.kind} {caller.serial} of {caller} was revoked; ask an operator for another one"
    return PermissionDenied(text, reason="UNAUTHENTICATED")
