"""The merge of several channels by time."""

from __future__ import annotations

from hypothesis import given, strategies

from stampede_rt.cli.merging import ALL_BYTES_MAX, CHANNEL_BYTES_MAX, CHANNEL_ITEMS_MAX, MergedItem, TimeMerge
from stampede_rt.values.model import Item


def item(time: int, payload: bytes = b"") -> Item:
    return Item(
        time=time, end=None, duration=None, seq=time, payload=payload, payload_length_bytes=len(payload),
        attributes={}, content_type="", incarnation=0,
    )  # fmt: skip


def merge_of(*names: str, wait_s: float = 1.0) -> TimeMerge:
    merge = TimeMerge(wait_s)
    for name in names:
        merge.join(name, 0.0)
    return merge


def all_of(merge: TimeMerge, now_s: float) -> list[MergedItem]:
    found = []
    while (one := merge.take(now_s)) is not None:
        found.append(one)
    return found


def test_an_item_waits_for_a_channel_without_items_at_most_for_the_stated_time() -> None:
    merge = merge_of("a", "b")
    merge.offer("a", item(5))
    assert merge.take(0.9) is None
    assert merge.due_s() == 1.0
    assert merge.take(1.0) == ("a", item(5), False)


def test_a_quiet_channel_does_not_delay_the_others() -> None:
    merge = merge_of("a", "quiet")
    for time in range(10):
        merge.offer("a", item(time))
    assert [one.item.time for one in all_of(merge, 1.5)] == list(range(10))


def test_an_item_with_an_earlier_time_than_a_printed_one_is_late_and_printed_immediately() -> None:
    merge = merge_of("a", "b")
    merge.offer("a", item(5))
    assert [one.late for one in all_of(merge, 1.0)] == [False]
    merge.offer("b", item(3))
    assert all_of(merge, 1.0) == [("b", item(3), True)]


def test_a_channel_that_has_ended_is_not_waited_for() -> None:
    merge = merge_of("a", "b")
    merge.offer("b", item(7))
    merge.leave("b")
    merge.offer("a", item(1))
    merge.leave("a")
    assert [one.item.time for one in all_of(merge, 0.0)] == [1, 7]


def test_each_channel_has_room_for_a_limited_number_of_items_and_bytes_and_always_for_one_item() -> None:
    merge = merge_of("many", "long")
    for time in range(CHANNEL_ITEMS_MAX):
        assert merge.has_room("many")
        merge.offer("many", item(time))
    assert not merge.has_room("many")
    assert merge.has_room("long")
    merge.offer("long", item(0, bytes(CHANNEL_BYTES_MAX + 1)))
    assert not merge.has_room("long")


@given(
    strategies.dictionaries(
        strategies.sampled_from("abcd"), strategies.lists(strategies.integers(0, 50), max_size=30), min_size=1
    )
)
def test_channels_in_order_of_time_are_printed_in_order_of_time_without_late_items(
    times: dict[str, list[int]],
) -> None:
    merge = merge_of(*times)
    for name, held in times.items():
        for time in sorted(held):
            merge.offer(name, item(time))
        merge.leave(name)
    found = all_of(merge, 0.0)
    assert [one.item.time for one in found] == sorted(time for held in times.values() for time in held)
    assert not any(one.late for one in found)


def test_all_channels_together_hold_a_bounded_number_of_bytes() -> None:
    names = [str(number) for number in range(128)]
    merge = merge_of(*names)
    large = bytes(ALL_BYTES_MAX // 4)
    taken = []
    for name in names:
        if merge.has_room(name):
            merge.offer(name, item(1, large))
            taken.append(name)
    assert len(taken) == 4
    assert merge.take(1.0) is not None
    assert merge.has_room(names[-1])
    assert [merge.take(now_s) is None for now_s in (2.0, 3.0, 4.0, 5.0)] == [False, False, False, True]
    assert all(merge.has_room(name) for name in names)
