"""Which of this machine's addresses leads where."""

from __future__ import annotations

import pytest

from stampede_rt_runtime.listen import CannotListen
from stampede_rt_runtime.routes import address_towards, is_loopback, is_of_another_machine


@pytest.mark.parametrize(
    "target", ["localhost:7580", "127.0.0.1:1", "127.8.0.1:1", "[::1]:1", "a.localhost:1", "unix:/x"]
)
def test_a_place_on_this_machine_alone_is_known_as_such(target: str) -> None:
    assert is_loopback(target)
    assert address_towards([target] if ":" in target and not target.startswith("unix:") else []) == "localhost"


@pytest.mark.parametrize("target", ["10.0.0.1:7580", "rig:7580", "[2001:db8::1]:7580", "0.0.0.0:7580"])
def test_a_place_that_others_may_call_is_not_taken_for_this_machine_alone(target: str) -> None:
    assert not is_loopback(target)


def test_a_place_to_which_no_way_leads_is_refused_with_what_to_do() -> None:
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
def test_a_caller_of_another_machine_is_told_from_one_of_this(peer: str, elsewhere: bool) -> None:
    assert is_of_another_machine(peer) is elsewhere
