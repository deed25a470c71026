"""Derives the caller from the credentials that a call brings. Pure."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from stampede_rt.errors import PermissionDenied
from stampede_rt_runtime.access.caller import ANYONE, Caller, CallerCertificate, by_certificate, by_secret

SCHEME = b"Bearer "
_SEARCHED_FILES = (
    "the file that --secret-file or $STAMPEDE_SECRET_FILE names, else $XDG_CONFIG_HOME/stampede/secret, else "
    "~/.config/stampede/secret"
)


@dataclass(frozen=True, kw_only=True, slots=True)
class AcceptedCredentials:
    """The credentials that a service accepts. A service that accepts no credential asks for none.

    `cluster`: the cluster of the service's own certificate; empty if callers need no certificates. `read_token`:
    returns the caller of a token, or None for a text that is not a token; raises PermissionDenied or Unavailable.
    """

    secrets: tuple[str, ...] = field(default=(), repr=False)
    client_secrets: tuple[str, ...] = field(default=(), repr=False)
    cluster: str = ""
    read_token: Callable[[str], Caller | None] = lambda text: None


def identify(
    accepted: AcceptedCredentials, authorization: bytes | None, certificate: CallerCertificate | None
) -> Caller:
    """The caller who sent this `authorization` metadata and this certificate.

    Raises PermissionDenied, and the errors of `read_token`.
    """
    certified = _certified(accepted, certificate) if accepted.cluster else None
    credential = _credential_in(authorization)
    token = _token(accepted, credential)
    if token is not None:
        # the token comes first, because it names one client, and many clients may share a certificate
        return replace(token, connection=certified)
    secret = _by_secret(accepted, credential) if accepted.secrets else None
    return certified or secret or ANYONE


def identify_by_certificate(accepted: AcceptedCredentials, certificate: CallerCertificate | None) -> Caller:
    """The caller of a method that needs no secret: the owner of the certificate, if the service has certificates."""
    return _certified(accepted, certificate) if accepted.cluster else ANYONE


def _credential_in(authorization: bytes | None) -> bytes | None:
    """The secret or token in the metadata; None if the metadata has none, and empty if they have another scheme."""
    if authorization is None:
        return None
    return authorization[len(SCHEME) :] if authorization.startswith(SCHEME) else b""


def _certified(accepted: AcceptedCredentials, certificate: CallerCertificate | None) -> Caller:
    if certificate is None:
        raise PermissionDenied(
            "the caller's certificate does not name exactly one role of a cluster (one URI "
            "stampede://CLUSTER/ROLE/NAME); make one with `stampede certs issue`. A stream over a socket must bring "
            "the ticket that the host gave with the address of the socket"
        )
    if certificate.identity.cluster != accepted.cluster:
        raise PermissionDenied(
            f"the certificate is one of cluster {certificate.identity.cluster}, but this service is of cluster "
            f"{accepted.cluster}; use a certificate of cluster {accepted.cluster}"
        )
    return by_certificate(certificate)


def _token(accepted: AcceptedCredentials, credential: bytes | None) -> Caller | None:
    if credential is None:
        return None
    try:
        return accepted.read_token(credential.decode())
    except UnicodeDecodeError:
        return None


def _by_secret(accepted: AcceptedCredentials, credential: bytes | None) -> Caller:
    if credential is None:
        raise _refused(
            "the call brought no secret",
            f"copy the service's secret file to one of the files that callers read: {_SEARCHED_FILES}. A client sends "
            "it to another machine only if $STAMPEDE_SECRET_FILE, or connect(secret=...), names it",
        )
    for secrets, is_cluster_secret in ((accepted.secrets, True), (accepted.client_secrets, False)):
        if _is_one_of(credential, secrets):
            return by_secret(of_cluster=is_cluster_secret)
    raise _refused(
        "the call brought a secret that differs from the service's",
        f"the caller read its secret from {_SEARCHED_FILES}: replace that file by the service's own",
    )


def _is_one_of(credential: bytes, secrets: tuple[str, ...]) -> bool:
    return any(hmac.compare_digest(credential, secret.encode()) for secret in secrets)


def _refused(what: str, remedy: str) -> PermissionDenied:
    return PermissionDenied(f"{what}; {remedy}", reason="UNAUTHENTICATED")
