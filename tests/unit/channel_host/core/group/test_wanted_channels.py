"""The groups of one caller do not leave out the groups of others when two hosts exchange times."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from hypothesis import given, strategies

from stampede_rt_channel_host.core.group.wanted_channels import WantedChannels


def ids(*numbers: int) -> list[bytes]:
    return [number.to_bytes(16) for number in numbers]


def numbers(channel_ids: Iterable[bytes]) -> set[int]:
    return {int.from_bytes(one) for one in channel_ids}


def test_the_channels_of_one_creator_may_use_all_free_room() -> None:
    wanted = WantedChannels(4)
    wanted.add("hostile", ids(1, 2, 3, 4, 5))
    assert numbers(wanted.requested) == {1, 2, 3, 4}
    assert wanted.left_out == 1


def test_channels_of_others_displace_the_newest_channels_of_the_creator_with_the_most() -> None:
    wanted = WantedChannels(4)
    wanted.add("hostile", ids(1, 2, 3, 4, 5))
    wanted.add("good", ids(11))
    assert numbers(wanted.requested) == {1, 2, 3, 11}
    wanted.add("good", ids(12, 13))
    assert numbers(wanted.requested) == {1, 2, 11, 12}
    assert wanted.largest_creator in ("hostile", "good")
    assert wanted.left_out == 4


def test_a_channel_above_the_limit_is_admitted_when_another_one_leaves() -> None:
    wanted = WantedChannels(2)
    wanted.add("one", ids(1, 2, 3))
    wanted.remove("one", ids(1))
    assert numbers(wanted.requested) == {2, 3}
    wanted.remove("one", ids(2, 3))
    assert not wanted
    assert not wanted.requested


def test_a_channel_of_two_creators_counts_for_the_second_if_the_first_has_no_room() -> None:
    wanted = WantedChannels(3)
    wanted.add("hostile", ids(1, 2, 11))
    wanted.add("good", ids(11))
    wanted.add("third", ids(21))
    assert numbers(wanted.requested) >= {11, 21}


def test_the_creator_with_most_channels_is_still_found_when_all_others_have_left() -> None:
    wanted = WantedChannels(10)
    wanted.add("a", ids(1, 2, 3))
    wanted.add("b", ids(4))
    wanted.remove("a", ids(1, 2, 3))
    assert wanted.largest_creator == "b"


STEPS = strategies.lists(strategies.tuples(strategies.integers(0, 3), strategies.integers(0, 11)), max_size=60)


@given(STEPS)
def test_creators_share_all_room_almost_evenly(steps: list[tuple[int, int]]) -> None:
    """A step adds a channel to a creator's group, or removes it if it is there."""
    limit, wanted, held = 5, WantedChannels(5), Counter[tuple[int, int]]()
    for creator, number in steps:
        if held[creator, number]:
            wanted.remove(f"{creator}", ids(number))
            del held[creator, number]
        else:
            wanted.add(f"{creator}", ids(number))
            held[creator, number] += 1
        channels = {number for _, number in held}
        assert numbers(wanted.requested) <= channels
        assert len(wanted.requested) == min(limit, len(channels))
        assert wanted.left_out == len(channels) - len(wanted.requested)
        assert bool(wanted) == bool(channels)


@given(STEPS)
def test_a_new_creator_gets_its_share_even_if_others_have_many_channels(steps: list[tuple[int, int]]) -> None:
    wanted = WantedChannels(8)
    for creator, number in steps:
        wanted.add(f"{creator}", ids(number))
    wanted.add("last", ids(100, 101, 102, 103))
    wanted_numbers = numbers(wanted.requested)
    creators = len({creator for creator, _ in steps}) + 1
    assert len(wanted_numbers & {100, 101, 102, 103}) >= min(4, 8 // creators)
