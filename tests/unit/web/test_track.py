"""Unit tests of `stampede_rt_web.track`: the columns of a channel's items, and the marks."""

from __future__ import annotations

from hypothesis import given, strategies

from stampede_rt_web.track import ABSENT, ITEMS_MAX, ItemTrack, TrackItem


def item(time: int, seq: int, duration: int = ABSENT) -> TrackItem:
    return TrackItem(time, duration, seq, 10)


def track_of(*items: TrackItem) -> ItemTrack:
    track = ItemTrack()
    track.begin_incarnation(1, 0)
    track.extend(items)
    return track


def test_a_skipped_seq_is_missing_until_its_late_item_arrives() -> None:
    track = track_of(item(10, 1), item(30, 3))
    assert track.has_missing
    track.add_late([item(10, 1), item(20, 2), item(30, 3)], now=99)
    assert list(track.seqs) == [1, 2, 3]
    assert [(mark.time, mark.kind) for mark in track.marks] == [(20, "late")]
    assert not track.has_missing


def test_a_missing_item_that_was_collected_is_marked_as_missed() -> None:
    track = track_of(item(10, 1), item(40, 4))
    track.add_late([item(30, 3)], now=99)
    assert [(mark.kind, mark.time) for mark in track.marks] == [("late", 30), ("missed", 99)]
    assert "1 item " in track.marks[-1].text


def test_a_channel_that_accepted_more_than_the_page_saw_has_missing_items() -> None:
    track = track_of(item(10, 1))
    track.expect(2)
    assert track.has_missing
    track.add_late([item(5, 2), item(10, 1)], now=99)
    assert list(track.times) == [5, 10]


def test_a_new_incarnation_is_marked_as_a_loss_and_its_seqs_begin_again() -> None:
    track = track_of(item(10, 7))
    track.begin_incarnation(2, now=50)
    track.extend([item(60, 1)])
    assert [(mark.kind, mark.time) for mark in track.marks] == [("lost", 50)]
    assert not track.has_missing


def test_the_first_incarnation_is_not_marked_as_a_loss() -> None:
    assert not track_of(item(10, 1)).marks


def test_older_items_are_added_before_the_others_while_there_is_room() -> None:
    track = track_of(*(item(1000 + n, 1000 + n) for n in range(ITEMS_MAX - 2)))
    track.prepend(item(n, n) for n in range(1, 6))
    assert len(track) == ITEMS_MAX
    assert list(track.times[:3]) == [4, 5, 1000]
    track.prepend([])
    assert len(track) == ITEMS_MAX


def test_the_oldest_items_leave_a_full_track() -> None:
    track = track_of(*(item(n, n) for n in range(1, ITEMS_MAX + 11)))
    assert len(track) == ITEMS_MAX
    assert track.times[0] == 11


@given(strategies.permutations(list(range(1, 40))), strategies.integers(1, 10))
def test_a_track_is_in_time_order_for_any_order_of_the_added_items(order: list[int], step: int) -> None:
    """The item with seq n has the time order[n - 1]. A poll follows after each `step` items."""
    track = ItemTrack()
    track.begin_incarnation(1, 0)
    accepted = [item(time, seq) for seq, time in enumerate(order, start=1)]
    for count in range(step, len(accepted) + step, step):
        held = sorted(accepted[:count])
        newest = track.times[-1] if track else 0
        track.extend(one for one in held if one.time > newest)
        track.expect(len(held))
        if track.has_missing:
            track.add_late(held, now=99)
    assert list(track.times) == sorted(order)
    assert all(mark.kind == "late" for mark in track.marks)
