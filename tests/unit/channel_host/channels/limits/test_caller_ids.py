"""The callers of consumer ids and taker ids."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import pytest

from stampede_rt.errors import PermissionDenied
from stampede_rt_channel_host.channels.limits import caller_ids as module
from stampede_rt_channel_host.channels.limits.caller_ids import IDS_OF_ONE_CALLER_MAX, CallerIds

QUEUE, OTHER = b"q" * 16, b"o" * 16


def allowed() -> None:
    """Stands for a check that lets the caller act at the thing."""


def denied() -> None:
    raise PermissionDenied("no rule")


def use(caller_ids: CallerIds, thing: bytes, number: int, what: str, check: Callable[[], None] = allowed) -> None:
    with caller_ids.using(thing, number, what, check):
        pass


@pytest.fixture
def caller(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The name of the caller; empty: a caller to which no rules apply."""
    names = ["alice"]
    monkeypatch.setattr(module, "owner_name", lambda: names[-1])
    return names


def test_a_number_belongs_to_the_caller_that_used_it_first(caller: list[str]) -> None:
    caller_ids = CallerIds()
    use(caller_ids, QUEUE, 7, "taker")
    use(caller_ids, QUEUE, 7, "taker")
    caller.append("thief")
    use(caller_ids, OTHER, 7, "taker")
    with pytest.raises(PermissionDenied, match="taker 0x7 belongs to alice, and thief may not act for it"):
        use(caller_ids, QUEUE, 7, "taker")
    caller.append("")
    use(caller_ids, QUEUE, 7, "taker")


def test_an_id_that_members_use_belongs_to_no_other_caller(caller: list[str]) -> None:
    caller_ids = CallerIds()
    caller.append("")
    use(caller_ids, QUEUE, 7, "consumer")
    caller.append("thief")
    with pytest.raises(PermissionDenied, match="belongs to a service or an operator"):
        use(caller_ids, QUEUE, 7, "consumer")


def test_a_caller_with_too_many_numbers_displaces_only_its_own_numbers(caller: list[str]) -> None:
    caller_ids = CallerIds()
    use(caller_ids, QUEUE, 7, "taker")
    caller.append("thief")
    for number in range(1000, 1000 + 3 * IDS_OF_ONE_CALLER_MAX):
        use(caller_ids, QUEUE, number, "taker")
    assert len(caller_ids) == IDS_OF_ONE_CALLER_MAX + 1
    with pytest.raises(PermissionDenied):
        use(caller_ids, QUEUE, 7, "taker")


def test_the_sum_of_all_numbers_is_bounded(caller: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "IDS_OF_ALL_CALLERS_MAX", 100)
    caller_ids = CallerIds()
    for number in range(300):
        caller.append(f"caller-{number}")
        use(caller_ids, QUEUE, number, "taker")
    assert len(caller_ids) == len(caller_ids._keys_by_caller) == 100


def test_a_caller_that_may_not_act_owns_no_number(caller: list[str]) -> None:
    """In an earlier version, a caller that had lost its right kept its number.

    A caller whose first call was refused kept one, too.
    """
    caller_ids = CallerIds()
    use(caller_ids, QUEUE, 7, "consumer")
    with pytest.raises(PermissionDenied, match="no rule"):
        use(caller_ids, QUEUE, 7, "consumer", denied)
    with pytest.raises(KeyError), caller_ids.using(QUEUE, 8, "consumer", allowed):
        raise KeyError("the channel has no place")
    assert len(caller_ids) == 0
    caller.append("bob")
    use(caller_ids, QUEUE, 7, "consumer")
    use(caller_ids, QUEUE, 8, "consumer")


def test_a_refused_stranger_takes_no_number_from_its_owner(caller: list[str]) -> None:
    caller_ids = CallerIds()
    use(caller_ids, QUEUE, 7, "consumer")
    with pytest.raises(KeyError), caller_ids.using(QUEUE, 7, "consumer", allowed):
        raise KeyError("a later call fails")
    caller.append("thief")
    for check in (denied, allowed):
        with pytest.raises(PermissionDenied):
            use(caller_ids, QUEUE, 7, "consumer", check)
    assert len(caller_ids) == 1


def test_an_id_belongs_to_its_caller_if_one_of_two_first_calls_succeeds(caller: list[str]) -> None:
    caller_ids = CallerIds()
    with suppress(KeyError), caller_ids.using(QUEUE, 7, "consumer", allowed):
        use(caller_ids, QUEUE, 7, "consumer")
        raise KeyError("the other call fails")
    assert len(caller_ids) == 1
