"""Matches: the nearest item of every other member, as soon as no nearer item can come."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from stampede_rt.matching.pairing import STEPS_MAX
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import ChannelCore, Position
from stampede_rt_channel_host.core.group import OWN, LocalTrack, Matcher, OwnChannelTimes, RemoteTrack
from stampede_rt_channel_host.core.group.loss_counter import LossCounter
from stampede_rt_channel_host.core.group.tracks import TRACK_ITEMS_MAX
from tests.support.channel_host.group_channels import INCARNATION, NOW, channel, put

RIGHT = b"right"


def passed(right: ChannelCore) -> Callable[[bytes, int], bool]:
    return lambda _, instant: OwnChannelTimes(right, NOW).times(1).has_passed(instant)


def everything(left: ChannelCore, right: ChannelCore, tolerance: int) -> Matcher:
    return Matcher(left, {RIGHT: LocalTrack(right)}, tolerance, NOW, after=Position(-1, 0))


def pairs(matcher: Matcher, right: ChannelCore) -> list[tuple[int, int | None]]:
    taken = matcher.take(passed(right), NOW, 100)
    return [(one.item.slice.first_time, one.matched[RIGHT].time if RIGHT in one.matched else None) for one in taken]


def test_each_item_gets_the_nearest_and_the_earlier_wins_a_tie() -> None:
    left, right = channel(10, 20, 30), channel(8, 12, 23, 40)
    matcher = everything(left, right, 5)
    assert pairs(matcher, right) == [(10, 8), (20, 23), (30, None)]
    assert matcher.unmatched == 1


def test_many_items_are_matched_together_within_the_credit(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right = channel(*range(10, 110)), channel(*range(10, 120))
    matcher, remote = everything(left, right, 1), RemoteTrack()
    remote.add((time, time) for time in range(10, 120))
    matcher.set_tracks({RIGHT: LocalTrack(right), b"remote": remote})
    settled: list[int] = []
    mark_read = LossCounter.mark_read

    def counting(self: LossCounter, *args: Any, **named: Any) -> int:
        settled.append(1)
        return mark_read(self, *args, **named)

    monkeypatch.setattr(LossCounter, "mark_read", counting)
    taken = matcher.take(lambda channel_id, instant: True, NOW, 64)
    assert ([one.item.slice.first_time for one in taken], len(settled)) == ([*range(10, 74)], 1)
    each = taken[0].charge_bytes
    assert each == 2 * taken[0].item.slice.charge_bytes  # the remote partner comes from its own host
    assert len(matcher.take(lambda channel_id, instant: True, NOW, 64, 3 * each - 1)) == 3
    assert matcher.take(lambda channel_id, instant: True, NOW, 64, 0) == []
    assert len(matcher.take(lambda channel_id, instant: True, NOW, 64)) == 33


def test_an_item_waits_until_every_other_member_has_passed_its_tolerance() -> None:
    left, right = channel(10), channel(9)
    matcher = everything(left, right, 5)
    assert pairs(matcher, right) == []
    right.advance(15, NOW)
    assert pairs(matcher, right) == []  # an item may still come at exactly 15
    right.advance(16, NOW)
    assert pairs(matcher, right) == [(10, 9)]


def test_an_item_whose_time_is_decided_is_dropped_and_counted() -> None:
    left, right = channel(10, 20), channel(10, 20, 40)
    matcher = everything(left, right, 1)
    assert len(pairs(matcher, right)) == 2
    put(left, 15)
    assert pairs(matcher, right) == []
    assert matcher.dropped == 1


def test_a_match_counts_items_that_leave_before_they_are_decided() -> None:
    left, right = channel(10, policy=Policy(max_items=2)), channel(1)
    matcher = everything(left, right, 1)
    for time in (20, 30):
        put(left, time)
    put(right, 100)
    assert [one for one, _ in pairs(matcher, right)] == [20, 30]
    assert matcher.dropped == 1


def test_a_host_keeps_a_bounded_number_of_keys_of_a_member_at_another_host() -> None:
    left = channel(10, 20)
    remote = RemoteTrack()
    remote.add([(11, 1), (9, 2), (19, 3), (19, 4), (21, 5)])
    matcher = Matcher(left, {RIGHT: remote}, 2, NOW, after=Position(-1, 0))
    taken = matcher.take(lambda channel_id, instant: True, NOW, 100)
    assert [(one.matched[RIGHT].time, one.matched[RIGHT].seq, one.matched[RIGHT].item) for one in taken] == [
        (9, 2, None),
        (19, 3, None),
    ]
    remote.add((time, time) for time in range(100, 100 + 2 * TRACK_ITEMS_MAX))
    assert remote.nearest(100, 5, NOW) is None
    assert remote.nearest(99 + 2 * TRACK_ITEMS_MAX, 5, NOW) is not None


def test_matching_begins_with_new_items_and_resumes_after_an_item() -> None:
    left, right = channel(10, 20), channel(10, 20, 90)
    assert pairs(Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW), right) == []
    resumed = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=Position(10, 1, INCARNATION))
    assert pairs(resumed, right) == [(20, 20)]


def test_late_items_between_two_streams_are_counted_as_dropped() -> None:
    left, right = channel(10, 20), channel(10, 20, 90)
    matcher = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=Position(-1, 0))
    assert pairs(matcher, right) == [(10, 10), (20, 20)]
    after, next_seq = matcher.position, matcher.next_seq
    put(left, 15)
    put(left, 30)
    resumed = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=after, next_seq=next_seq)
    pairs(resumed, right)
    assert (resumed.dropped, resumed.next_seq) == (1, next_seq + 2)
    uncounted = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=after)
    pairs(uncounted, right)
    assert uncounted.dropped == 0


def test_after_a_new_incarnation_all_earlier_items_are_counted_as_dropped() -> None:
    left, right = channel(10, 15, 30), channel(30, 90)
    former_position = Position(20, 7, INCARNATION + 1)
    resumed = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=former_position, next_seq=8)
    assert pairs(resumed, right) == [(30, 30)]
    assert resumed.dropped == 2


def test_matching_after_a_time_drops_and_counts_items_at_that_time() -> None:
    left, right = channel(10, 20), channel(10, 20, 90)
    matcher = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=Position(10))
    assert pairs(matcher, right) == [(20, 20)]
    matcher = Matcher(left, {RIGHT: LocalTrack(right)}, 1, NOW, after=Position(10))
    put(left, 10)
    assert pairs(matcher, right) == [(20, 20)]
    assert matcher.dropped == 1


def test_an_item_at_the_distance_of_the_tolerance_matches_and_may_match_two_items() -> None:
    left, remote = channel(10, 12), RemoteTrack()
    remote.add([(9, 1)])
    matcher = Matcher(left, {RIGHT: remote}, 3, NOW, after=Position(-1, 0))
    taken = [matcher.take(lambda channel_id, instant: True, NOW, 1)[0] for _ in range(2)]
    assert [one.matched[RIGHT].time for one in taken] == [9, 9]
    assert matcher.unmatched == 0


def test_an_item_without_a_match_in_two_members_counts_once() -> None:
    matcher = Matcher(channel(10), {RIGHT: RemoteTrack(), b"rear": RemoteTrack()}, 3, NOW, after=Position(-1, 0))
    (one,) = matcher.take(lambda channel_id, instant: True, NOW, 100)
    assert (one.missing, matcher.unmatched) == ((b"rear", RIGHT), 1)


def unique(left: ChannelCore, right: ChannelCore, tolerance: int) -> Matcher:
    return Matcher(left, {RIGHT: LocalTrack(right)}, tolerance, NOW, after=Position(-1, 0), partners={})


def matched(matcher: Matcher, left: ChannelCore, right: ChannelCore) -> list[tuple[int, int | None]]:
    """The results of a match that waits for its own channel, too."""
    times = {OWN: OwnChannelTimes(left, NOW).times(1), RIGHT: OwnChannelTimes(right, NOW).times(1)}
    taken = matcher.take(lambda name, instant: times[name].has_passed(instant), NOW, 100)
    return [(one.item.slice.first_time, one.matched[RIGHT].time if RIGHT in one.matched else None) for one in taken]


def test_with_unique_matches_the_nearer_of_two_items_gets_their_common_partner() -> None:
    left, right = channel(10, 14, 40), channel(5, 13, 60)
    assert matched(everything(left, right, 6), left, right) == [(10, 13), (14, 13), (40, None)]
    assert matched(unique(left, right, 6), left, right) == [(10, 5), (14, 13), (40, None)]


def test_a_unique_match_gives_a_partner_to_the_nearest_item() -> None:
    left, right = channel(0, 9, 40), channel(5, 9, 60)
    assert matched(unique(left, right, 5), left, right) == [(0, 5), (9, 9), (40, None)]


def test_a_unique_match_waits_until_no_later_item_can_be_nearer_to_its_partner() -> None:
    left, right = channel(10), channel(5, 15, 60)
    assert matched(unique(left, right, 6), left, right) == [(10, 5)], "no later item can be nearer to an earlier one"
    left, right = channel(10), channel(15, 60)
    matcher = unique(left, right, 6)
    assert matched(matcher, left, right) == []
    left.advance(19, NOW)
    assert matched(matcher, left, right) == [], "an item may come at 19"
    left.advance(20, NOW)
    assert matched(matcher, left, right) == [(10, 15)]


def test_a_chain_of_ever_nearer_items_is_followed_for_a_bounded_number_of_steps() -> None:
    gaps, ends = [*range(2 * STEPS_MAX + 9, 0, -1)], [0]
    for gap in gaps:
        ends.append(ends[-1] + gap)
    left, right = channel(*ends[::2], NOW - 1), channel(*ends[1::2], NOW - 1, policy=Policy(max_items=1000))
    steps: list[int] = []
    matcher = unique(left, right, gaps[0])
    (first,) = matcher.take(lambda name, instant: steps.append(instant) is None, NOW, 1)
    assert first.matched[RIGHT].time == ends[1]
    assert len(steps) < 3 * STEPS_MAX


def test_a_position_has_the_used_partners_so_that_no_match_repeats_them() -> None:
    left, right = channel(10, 14, 40), channel(12, 60)
    matcher = unique(left, right, 3)
    (first,) = matcher.take(lambda name, instant: True, NOW, 1)
    assert first.matched[RIGHT].time == 12
    resumed = Matcher(
        left, {RIGHT: LocalTrack(right)}, 3, NOW, matcher.position, matcher.next_seq, partners=matcher.partners
    )
    assert matched(resumed, left, right) == [(14, None), (40, None)]


def test_a_late_item_is_awaited_and_matched_as_the_nearest() -> None:
    left, right = channel(10, 20, 35), channel(8, 35)
    matcher, late = everything(left, right, 5), everything(left, right, 5)
    own = {OWN: left, RIGHT: right}

    def has_passed(name: bytes, instant: int) -> bool:
        return OwnChannelTimes(own[name], NOW).times(1).has_passed(instant, 20)

    assert late.take(has_passed, NOW, 100) == []
    assert len(matcher.take(lambda name, instant: instant < 30, NOW, 100)) == 2
    for time in (9, 19):
        put(right, time)
    put(left, 15)
    matcher.take(lambda name, instant: True, NOW, 100)
    assert matcher.dropped == 1
    for channel_of in (left, right):
        put(channel_of, 46)
    taken = late.take(has_passed, NOW, 100)
    assert [(one.item.slice.first_time, one.matched[RIGHT].time) for one in taken] == [(10, 9), (15, 19), (20, 19)]
    assert late.dropped == 0


@pytest.mark.parametrize("unique", [False, True])
def test_very_many_members_are_looked_at_some_at_a_time(unique: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, one message of unique matches took 130 ms with 31 members, and more than a second with 255
    members.
    """
    gaps = [*range(400, 0, -10)]  # each item is nearer to the next item than to the item before it
    times = [1000 + sum(gaps[:at]) for at in range(len(gaps))]
    left, members = channel(*times[::2]), {bytes([number]): channel(*times[1::2]) for number in range(40)}

    def matcher() -> Matcher:
        tracks = {member: LocalTrack(one) for member, one in members.items()}
        return Matcher(left, tracks, 5000, NOW, after=Position(-1, 0), partners={} if unique else None)

    looks, nearest = 0, LocalTrack.nearest

    def counting(*args: Any, **named: Any) -> Any:
        nonlocal looks
        looks += 1
        return nearest(*args, **named)

    in_one_call = matcher().take(lambda channel_id, instant: True, NOW, 100)
    monkeypatch.setattr(LocalTrack, "nearest", counting)
    made, found, most = matcher(), [], 0
    while True:
        looks = 0
        part = made.take(lambda channel_id, instant: True, NOW, 100, looks_max=128)
        most = max(most, looks)
        found += part
        if not part and not made.has_more:
            break
    assert found == in_one_call
    assert len(found) == len(times) // 2
    assert most <= 128 + 2 * STEPS_MAX + 1
