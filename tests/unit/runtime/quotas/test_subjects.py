"""The subjects for which a quota counts."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.access.caller import ANYONE, Caller, CallerKind, by_secret
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.quotas.subjects import creator_of, subject_of

PEER = "ipv4:10.0.0.3:5012"


def named(kind: CallerKind, role: Role) -> Caller:
    return Caller(kind=kind, roles=frozenset({role}), name="one")


@pytest.mark.parametrize("kind", [CallerKind.CERTIFICATE, CallerKind.TOKEN])
def test_a_named_client_is_identified_by_its_name_at_every_address(kind: CallerKind) -> None:
    assert subject_of(named(kind, Role.CLIENT), PEER) == "one"


@pytest.mark.parametrize("role", [Role.HOST, Role.SUPERNODE, Role.FRONTEND, Role.OPERATOR])
def test_services_of_the_cluster_and_operators_have_no_quota(role: Role) -> None:
    assert subject_of(named(CallerKind.CERTIFICATE, role), PEER) is None


@pytest.mark.parametrize("caller", [by_secret(of_cluster=False), by_secret(of_cluster=True), ANYONE])
def test_a_caller_without_a_name_counts_under_its_address(caller: Caller) -> None:
    assert subject_of(caller, PEER) == "@10.0.0.3"


def test_the_directory_counts_the_things_of_a_caller_under_its_name() -> None:
    assert creator_of(named(CallerKind.TOKEN, Role.CLIENT)) == "one"
    assert creator_of(named(CallerKind.TOKEN, Role.OPERATOR)) is None
    assert creator_of(by_secret(of_cluster=False)) == "@clients"
    assert creator_of(by_secret(of_cluster=True)) == "@cluster"


@pytest.mark.parametrize(
    ("peer", "subject"),
    [
        ("ipv6:%5B::1%5D:5", "@localhost"),
        ("ipv6:[::1]:5", "@localhost"),
        ("ipv4:127.0.0.9:5", "@localhost"),
        ("ipv6:%5B2001:db8:1:2:aaaa::7%5D:5", "@2001:db8:1:2::/64"),
        ("ipv6:%5B2001:db8:1:2:bbbb::8%5D:5", "@2001:db8:1:2::/64"),
        ("ipv6:%5Bfe80::1%25eth0%5D:5", "@fe80::/64"),
        ("ipv6:%5B::ffff:10.0.0.3%5D:5", "@10.0.0.3"),
        ("ipv6:%5Bnonsense%5D:5", "@nonsense"),
        ("unix:", "@localhost"),
        ("", "@unknown"),
    ],
)
def test_all_addresses_that_one_machine_can_use_count_as_one_caller(peer: str, subject: str) -> None:
    assert subject_of(by_secret(of_cluster=False), peer) == subject
