"""The credentials of a call decide which caller it has."""

from __future__ import annotations

import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt_runtime.access.caller import ALL_ROLES, ANYONE, Caller, CallerCertificate, CallerKind
from stampede_rt_runtime.access.credentials import AcceptedCredentials, identify
from stampede_rt_runtime.identity import Identity, Role

TOKEN = Caller(kind=CallerKind.TOKEN, roles=frozenset({Role.CLIENT}), name="cam", serial="1")


def read_token(text: str) -> Caller | None:
    if text == "token-that-has-expired":
        raise PermissionDenied("the token has expired", reason="UNAUTHENTICATED")
    return TOKEN if text == "token" else None


OPEN = AcceptedCredentials(read_token=read_token)
ONE = AcceptedCredentials(secrets=("s",), read_token=read_token)
TWO = AcceptedCredentials(secrets=("s", "s-new"), client_secrets=("c", "c-new"), read_token=read_token)
CERTIFIED = AcceptedCredentials(cluster="lab", read_token=read_token)
HOST = CallerCertificate(Identity("lab", Role.HOST, "h1"))


@pytest.mark.parametrize(
    ("accepted", "sent", "certificate", "name", "roles"),
    [
        (OPEN, None, None, "@anyone", ALL_ROLES),
        (OPEN, b"Bearer whatever", None, "@anyone", ALL_ROLES),
        (OPEN, b"Bearer token", None, "cam", {Role.CLIENT}),
        (ONE, b"Bearer s", None, "@cluster", ALL_ROLES),
        (ONE, b"Bearer token", None, "cam", {Role.CLIENT}),
        (TWO, b"Bearer s-new", None, "@cluster", ALL_ROLES),
        (TWO, b"Bearer c", None, "@clients", {Role.CLIENT}),
        (TWO, b"Bearer c-new", None, "@clients", {Role.CLIENT}),
        (CERTIFIED, None, HOST, "h1", {Role.HOST}),
        (CERTIFIED, b"Bearer s", HOST, "h1", {Role.HOST}),
        (CERTIFIED, b"Bearer token", HOST, "cam", {Role.CLIENT}),
    ],
)
def test_each_credential_gives_a_name_and_roles(
    accepted: AcceptedCredentials,
    sent: bytes | None,
    certificate: CallerCertificate | None,
    name: str,
    roles: set[Role],
) -> None:
    caller = identify(accepted, sent, certificate)
    assert (caller.name, caller.roles) == (name, roles)


@pytest.mark.parametrize(
    ("accepted", "sent", "certificate", "expected"),
    [
        (ONE, None, None, "brought no secret"),
        (ONE, b"s", None, "a secret that differs"),
        (ONE, b"bearer s", None, "a secret that differs"),
        (ONE, b"Bearer ", None, "a secret that differs"),
        (ONE, b"Bearer \xff", None, "a secret that differs"),
        (ONE, b"Bearer c", None, "a secret that differs"),
        (ONE, b"Bearer token-that-has-expired", None, "the token has expired"),
        (CERTIFIED, b"Bearer token", None, "does not name exactly one role"),
        (CERTIFIED, None, CallerCertificate(Identity("other", Role.HOST, "h1")), "this service is of cluster lab"),
    ],
)
def test_a_malformed_credential_is_refused_with_the_reason(
    accepted: AcceptedCredentials, sent: bytes | None, certificate: CallerCertificate | None, expected: str
) -> None:
    with pytest.raises(PermissionDenied, match=expected):
        identify(accepted, sent, certificate)


def test_a_token_is_valid_only_as_long_as_the_certificate_of_its_connection() -> None:
    """In an earlier version, a client went on with a revoked or expired certificate if it also brought a token."""
    certificate = CallerCertificate(Identity("lab", Role.CLIENT, "shared"), serial="ce", ends_unix_nano=50)
    caller = identify(CERTIFIED, b"Bearer token", certificate)
    assert (caller.name, caller.kind, caller.first_end_unix_nano) == ("cam", CallerKind.TOKEN, 50)
    for serial, kind in (("1", CallerKind.TOKEN), ("ce", CallerKind.CERTIFICATE)):
        revoked = caller.revoked_among({serial})
        assert revoked is not None
        assert (revoked.serial, revoked.kind) == (serial, kind)
    assert caller.revoked_among({"other"}) is None
    assert caller.ended_by(49) is None
    assert caller.ended_by(50) is caller.connection
    assert identify(ONE, b"Bearer token", None).first_end_unix_nano == 0


def test_rules_apply_to_clients_and_neither_to_operators_nor_to_services() -> None:
    assert TOKEN.is_judged
    assert not ANYONE.is_judged
    for role in Role:
        caller = Caller(kind=CallerKind.CERTIFICATE, roles=frozenset({role}), name="n")
        assert caller.is_judged == (role is Role.CLIENT)


def test_secrets_are_not_shown() -> None:
    assert "s-new" not in repr(TWO)
    assert "c-new" not in repr(TWO)
