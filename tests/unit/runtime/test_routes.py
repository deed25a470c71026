"""The reach of this machine's addresses."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.listen import CannotListen
from stampede_rt_runtime.routes import address_towards, is_of_another_machine


@pytest.mark.parametrize("target", ["localhost:7580", "127.0.0.1:1", "[::1]:1"])
def test_only_loopback_addresses_count_as_this_machine(target: str) -> None:
    assert address_towards([target]) == "localhost"


def test_an_address_without_a_route_is_refused_with_advice() -> None:
    with pytest.raises(CannotListen, match=r"no address of this machine is known to lead to nowhere\.invalid:7580"):
        address_towards(["nowhere.invalid:7580"])


@pytest.mark.parametrize(
    ("peer", "elsewhere"),
    [
        ("ipv4:127.0.0.1:4000", False),
        ("ipv6:%5B::1%5D:4000", False),
        ("unix:", False),
        ("ipv4:192.0.2.77:4000", True),
        ("ipv6:%5B2001:db8::7%5D:4000", True),
    ],
)
def test_callers_of_this_machine_and_of_others_are_distinguished(peer: str, elsewhere: bool) -> None:
    assert is_of_another_machine(peer) is elsewhere
