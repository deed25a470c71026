"""Client tokens."""

from __future__ import annotations

from dataclasses import replace

import pytest

from stampede_rt.errors import InvalidArgument, PermissionDenied, Unavailable
from stampede_rt_runtime.access.control import AccessControl
from stampede_rt_runtime.access.state import AccessState
from stampede_rt_runtime.access.tokens import (
    VALID_NANOS_MAX,
    TokenClaims,
    check_claims,
    is_token,
    make_token,
    public_key,
    read_token,
)
from stampede_rt_runtime.identity import Role
from tests.support.clock import ManualClock

PRIVATE, OTHER = b"1" * 32, b"2" * 32
KEY = public_key(PRIVATE)
CLAIMS = TokenClaims(cluster_id="c", name="cam/1", roles=(Role.CLIENT,), serial="a1", ends_unix_nano=10**18)
TOKEN = make_token(PRIVATE, CLAIMS)


def test_a_token_read_from_its_text_has_the_same_claims() -> None:
    assert is_token(TOKEN)
    assert read_token(TOKEN, keys=[public_key(OTHER), KEY], cluster_id="c") == CLAIMS


def test_a_changed_token_is_refused() -> None:
    for place in range(len(TOKEN)):
        changed = TOKEN[:place] + ("A" if TOKEN[place] != "A" else "B") + TOKEN[place + 1 :]
        if changed.rstrip(".")[:-1] == TOKEN[:-1]:
            continue  # the last character of base64 has bits that mean nothing
        with pytest.raises(PermissionDenied):
            read_token(changed, keys=[KEY], cluster_id="c")


@pytest.mark.parametrize("text", ["", ".", "stampede-token-1.", TOKEN[:-5], TOKEN + ".", "stampede-token-1.é.é"])
def test_a_malformed_token_is_refused_like_a_foreign_one(text: str) -> None:
    with pytest.raises(PermissionDenied):
        read_token(text, keys=[KEY], cluster_id="c")


def test_a_token_of_another_cluster_or_key_is_refused() -> None:
    for keys, cluster in (([KEY], "d"), ([public_key(OTHER)], "c"), ([], "c")):
        with pytest.raises(PermissionDenied, match="this cluster has not signed the token"):
            read_token(TOKEN, keys=keys, cluster_id=cluster)


@pytest.mark.parametrize(
    ("name", "roles", "valid_nanos", "error"),
    [
        ("@clients", ["client"], 1, "the token's name"),
        ("", ["client"], 1, "the token's name"),
        ("a", [], 1, "roles are none"),
        ("a", ["host"], 1, "roles are host"),
        ("a", ["client"], 0, "valid_nanos is 0"),
        ("a", ["client"], VALID_NANOS_MAX + 1, "at most 30 days"),
    ],
)
def test_only_clients_and_operators_get_tokens(name: str, roles: list[str], valid_nanos: int, error: str) -> None:
    with pytest.raises(InvalidArgument, match=error):
        check_claims(name, roles, valid_nanos)
    assert check_claims("a", ["operator", "client", "client"], 1) == (Role.CLIENT, Role.OPERATOR)


def test_a_port_accepts_a_token_until_it_ends_and_only_if_the_port_has_its_key() -> None:
    clock = ManualClock()
    control = AccessControl(time_unix_nano=clock.time_unix_nano)
    token = make_token(PRIVATE, replace(CLAIMS, ends_unix_nano=clock.time_unix_nano() + 5))
    with pytest.raises(Unavailable):
        control.read_token(token)
    control.set_state(AccessState(cluster_id="c"))
    with pytest.raises(Unavailable):
        control.read_token(token)
    control.set_state(AccessState(version=1, cluster_id="c", token_keys=(KEY,)))
    assert str(control.read_token(token)) == "client cam/1"
    clock.advance(5)
    with pytest.raises(PermissionDenied, match="the token of cam/1 has ended"):
        control.read_token(token)
    clock.advance(-5)
    control.set_state(AccessState(version=2, cluster_id="c", token_keys=(public_key(OTHER),)))
    with pytest.raises(PermissionDenied):
        control.read_token(token)
    assert control.read_token("a secret") is None
