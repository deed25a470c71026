"""The cut of a group, and the members that hold it back."""

from __future__ import annotations

import random

from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.group import ChannelTimes, GroupCut, GroupDefinition, OwnChannelTimes, TimesBoard
from tests.support.channel_host.group_channels import INCARNATION, NOW, channel, put

A, B = b"a", b"b"
S = 10**9


def group(**times: ChannelTimes) -> tuple[GroupCut, TimesBoard]:
    """A settled group of a and b with these known times."""
    return defined(GroupDefinition(members=frozenset((A, B))), **times)


def defined(definition: GroupDefinition, **times_of: ChannelTimes) -> tuple[GroupCut, TimesBoard]:
    board = TimesBoard()
    for name, times in times_of.items():
        board.receive(name.encode(), times, 0, 0)
    cut = GroupCut(definition, board)
    cut.confirm()
    cut.refresh(0)
    return cut, board


def at(newest: int, *, epoch: int = 1, incarnation: int = 7, end: int | None = None) -> ChannelTimes:
    return ChannelTimes(epoch, incarnation, newest, end)


def test_the_channel_that_lags_most_holds_the_cut_back_in_mode_oldest() -> None:
    cut, board = group(a=at(100), b=at(70))
    assert cut.cut == 70
    assert cut.waiting_on(0) == [B]
    board.receive(B, at(130), 0, 0)
    assert cut.refresh(0)
    assert (cut.cut, cut.waiting_on(0)) == (100, [A])


def test_no_item_is_visible_before_every_channel_has_reported() -> None:
    cut, board = group(a=at(100))
    assert cut.cut is None
    assert cut.waiting_on(0) == [B]
    board.receive(B, ChannelTimes(1, 7, advance=40), 0, 0)
    cut.refresh(0)
    assert cut.cut == 40


def test_only_the_reference_channel_decides_the_cut() -> None:
    definition = GroupDefinition(members=frozenset((A, B)), reference=A)
    cut, board = defined(definition, a=at(100))
    assert (cut.cut, cut.waiting_on(0)) == (100, [A])
    board.receive(B, at(10), 0, 0)
    assert not cut.refresh(0)


def test_the_end_of_the_newest_item_may_be_the_cut_but_not_further_than_max_lead() -> None:
    definition = GroupDefinition(members=frozenset((A,)), reference=A, by_end=True, max_lead_nanos=5)
    assert defined(definition, a=at(100, end=103))[0].cut == 103
    assert defined(definition, a=at(100, end=200))[0].cut == 105
    assert defined(definition, a=at(100))[0].cut == 100


def test_an_advance_beyond_the_newest_item_is_the_cut_and_an_earlier_one_is_not() -> None:
    for by_end in (False, True):
        definition = GroupDefinition(members=frozenset((A,)), by_end=by_end)
        assert defined(definition, a=ChannelTimes(1, 7, 100, advance=120))[0].cut == 120
        assert defined(definition, a=ChannelTimes(1, 7, 100, advance=80))[0].cut == 100


def test_with_bound_start_durations_do_not_move_the_cut() -> None:
    assert defined(GroupDefinition(members=frozenset((A,))), a=at(100, end=103))[0].cut == 100


def test_the_cut_never_moves_back() -> None:
    definition = GroupDefinition(members=frozenset((A,)), by_end=True)
    cut, board = defined(definition, a=at(100, end=150))
    board.receive(A, at(110), 0, 0)
    assert not cut.refresh(0)
    assert cut.cut == 150
    board.receive(A, at(5, epoch=2, incarnation=8), 0, 0)  # the host of A was lost, with all items of A
    assert not cut.refresh(0)
    assert (cut.cut, cut.waiting_on(0)) == (150, [A])


def test_an_added_member_does_not_move_the_cut_back_and_a_removed_one_releases_it() -> None:
    cut, board = group(a=at(100), b=at(70))
    cut.define(GroupDefinition(members=frozenset((A, B, b"c")), spec_version=2))
    board.receive(b"c", at(10), 0, 0)
    cut.refresh(0)
    assert (cut.cut, cut.waiting_on(0)) == (70, [B, b"c"])
    cut.define(GroupDefinition(members=frozenset((A,)), spec_version=3))
    cut.refresh(0)
    assert cut.cut == 100


def test_a_silent_member_is_left_out_until_its_next_item() -> None:
    definition = GroupDefinition(members=frozenset((A, B)), idle_after_nanos=S)
    board = TimesBoard()
    board.enter_own(A, at(100), 0)
    board.enter_own(B, at(70), 0)
    cut = GroupCut(definition, board)
    cut.confirm()
    cut.refresh(0)
    assert (cut.cut, cut.next_idle(0)) == (70, S)
    board.enter_own(A, at(120), S)
    cut.refresh(S)
    assert (cut.cut, cut.waiting_on(S), cut.next_idle(S)) == (120, [A], 2 * S)
    assert [member.is_idle for member in cut.members(S)] == [False, True]
    board.enter_own(B, at(80), S)
    cut.refresh(S)
    assert (cut.cut, cut.waiting_on(S)) == (120, [A, B])


def test_the_member_with_the_latest_item_decides_the_cut_if_all_members_are_silent() -> None:
    definition = GroupDefinition(members=frozenset((A, B)), idle_after_nanos=S)
    board = TimesBoard()
    board.enter_own(A, at(100), 0)
    board.enter_own(B, at(70), -1)
    cut = GroupCut(definition, board)
    cut.confirm()
    assert cut.refresh(5 * S)  # no call refreshed the cut while B alone was silent
    assert (cut.cut, cut.waiting_on(5 * S), cut.next_idle(5 * S)) == (100, [A], None)


def test_a_member_at_an_unreachable_host_holds_the_cut_back_even_if_it_would_count_as_silent() -> None:
    definition = GroupDefinition(members=frozenset((A, B)), idle_after_nanos=S)
    cut, board = defined(definition, a=at(100), b=at(70))
    board.confirm([A], 5 * S)
    cut.refresh(5 * S)
    assert (cut.cut, cut.waiting_on(5 * S), cut.next_idle(5 * S)) == (70, [B], None)
    board.confirm([B], 5 * S)
    board.receive(A, at(110), 0, 5 * S)
    cut.refresh(5 * S)
    assert cut.cut == 110


def test_the_cut_of_another_host_counts_and_no_item_is_shown_before_it_is_known() -> None:
    board = TimesBoard()
    board.enter_own(A, at(100), 0)
    cut = GroupCut(GroupDefinition(members=frozenset((A,))), board)
    assert not cut.refresh(0)
    assert cut.cut is None
    assert cut.merge_floor(300)
    assert not cut.merge_floor(200)
    assert cut.cut is None
    cut.confirm()
    assert cut.cut == 300


def test_the_times_of_another_incarnation_replace_the_earlier_ones() -> None:
    cut, _ = group(a=at(100), b=at(70))
    cut.define(GroupDefinition(members=frozenset((A, B)), incarnation=2))
    assert cut.cut is None
    cut.confirm()
    cut.refresh(0)
    assert cut.cut == 70


def test_reports_of_a_former_owner_change_nothing() -> None:
    board = TimesBoard()
    assert board.receive(A, at(50, epoch=3, incarnation=9), 0, 0)
    assert not board.receive(A, at(99, epoch=2), 0, 0)
    assert board.receive(A, at(60, epoch=4, incarnation=9), 0, 0)
    found = board.find(A)
    assert found is not None
    assert found.times == at(60, epoch=4, incarnation=9)


def test_an_item_that_all_consumers_consumed_before_the_group_existed_counts_for_the_cut() -> None:
    """A channel that never had an item or an advance has no cut; this channel had an item."""
    used = channel(100, 120, policy=Policy(consumers=1, max_items=10))
    used.consume(1, [1, 2], NOW)
    assert used.newest is None
    assert OwnChannelTimes(used, NOW).times(1).newest == 120
    put(used, 110)  # a late item, which a channel with consumers accepts
    assert OwnChannelTimes(used, NOW).times(1) == ChannelTimes(1, INCARNATION, 120)


def test_a_former_owner_does_not_count_and_still_receives_times() -> None:
    board = TimesBoard()
    board.enter_own(A, at(50, epoch=3), 0)
    assert board.receive(A, at(60, epoch=4), 0, 10)
    board.enter_own(A, at(99, epoch=3), 20)  # this host has not learned yet that it lost the channel
    assert board.receive(A, at(70, epoch=4), 0, 30)
    found = board.find(A)
    assert found is not None
    assert (found.times, found.known_until) == (at(70, epoch=4), 30)


def test_a_new_incarnation_of_a_channel_holds_the_cut_back_until_its_items_have_passed_the_cut() -> None:
    cut, board = group(a=at(90), b=at(100))
    board.receive(B, at(20, epoch=2, incarnation=8), 0, 0)  # the host of B was lost
    board.receive(A, at(95), 0, 0)
    assert not cut.refresh(0)
    assert (cut.cut, cut.waiting_on(0)) == (90, [B])
    board.receive(B, at(97, epoch=2, incarnation=8), 0, 0)
    cut.refresh(0)
    assert cut.cut == 95


def test_the_lowest_of_many_channels_is_always_known() -> None:
    draw, ids = random.Random(3), [bytes([number]) for number in range(9)]
    board, known = TimesBoard(), dict.fromkeys(ids, at(0))
    cut = GroupCut(GroupDefinition(members=frozenset(ids[:6])), board)
    cut.confirm()
    highest = 0
    for step in range(3_000):
        moving = draw.choice(ids)
        before = known[moving]
        known[moving] = before._replace(newest=(before.newest or 0) + draw.randrange(30))
        if step % 97 == 0:
            known[moving] = at(draw.randrange(highest + 1), epoch=step, incarnation=before.incarnation + 1)
        if step % 211 == 0:
            cut.define(GroupDefinition(members=frozenset(draw.sample(ids, 6)), spec_version=step))
        board.receive(moving, known[moving], 0, step)
        cut.refresh(step)
        members = cut.definition.members
        times = [board.find(one) for one in members]
        lowest = min(known[one].newest or 0 for one in members)
        highest = highest if None in times else max(highest, lowest)
        assert (cut.cut or 0) == highest
