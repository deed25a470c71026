"""The moments at which a reader of datagrams asks for missing items, and at which it leaves multicast."""

from __future__ import annotations

from stampede_rt.multicast.repair_pace import (
    BEAT_S_MAX,
    KEY_REQUEST_S,
    REORDERED_S,
    REPAIRS_WITHOUT_ITEM_MAX,
    SILENT_S,
    RepairPace,
    RepairStep,
)


def test_a_reader_waits_for_datagrams_that_overtake_each_other_before_it_asks() -> None:
    pace = RepairPace(0.0)
    step, wait_s = pace.next_step(0.0, is_missing=True)
    assert (step, wait_s) == (RepairStep.WAIT, REORDERED_S)
    assert pace.next_step(REORDERED_S, is_missing=True)[0] is RepairStep.REPAIR
    pace.note_request()
    assert pace.next_step(REORDERED_S, is_missing=True)[0] is RepairStep.WAIT


def test_a_late_datagram_needs_no_repair() -> None:
    pace = RepairPace(0.0)
    assert pace.next_step(0.0, is_missing=True)[0] is RepairStep.WAIT
    assert pace.next_step(REORDERED_S, is_missing=False)[0] is RepairStep.WAIT
    assert pace.next_step(REORDERED_S, is_missing=True)[0] is RepairStep.WAIT


def test_a_reader_leaves_multicast_after_a_silence_and_each_message_ends_the_silence() -> None:
    pace = RepairPace(0.0)
    step, wait_s = pace.next_step(0.0, is_missing=False)
    assert step is RepairStep.WAIT
    assert wait_s > SILENT_S
    pace.note_message(1.0)
    assert pace.next_step(SILENT_S + 0.5, is_missing=False)[0] is RepairStep.WAIT
    assert pace.next_step(SILENT_S + 1.1, is_missing=False)[0] is RepairStep.LEAVE


def test_a_reader_that_gets_all_items_by_repairs_leaves_multicast() -> None:
    pace = RepairPace(0.0)
    for _ in range(REPAIRS_WITHOUT_ITEM_MAX):
        pace.note_request()
    assert pace.next_step(0.0, is_missing=False)[0] is RepairStep.WAIT
    pace.note_request()
    assert pace.next_step(0.0, is_missing=False)[0] is RepairStep.LEAVE
    pace.note_items()
    assert pace.next_step(0.0, is_missing=False)[0] is RepairStep.WAIT


def test_a_reader_opens_another_stream_immediately_after_the_end_of_the_datagrams() -> None:
    pace = RepairPace(0.0)
    pace.note_end()
    assert pace.next_step(0.0, is_missing=True)[0] is RepairStep.REOPEN


def test_datagrams_with_another_key_make_a_reader_ask_once_a_second() -> None:
    pace = RepairPace(0.0)
    pace.note_other_key(0.0)
    assert pace.next_step(0.0, is_missing=False)[0] is RepairStep.REPAIR
    pace.note_request()
    pace.note_other_key(KEY_REQUEST_S / 2)
    assert pace.next_step(KEY_REQUEST_S / 2, is_missing=False)[0] is RepairStep.WAIT
    pace.note_other_key(KEY_REQUEST_S)
    assert pace.next_step(KEY_REQUEST_S, is_missing=False)[0] is RepairStep.REPAIR


def test_requests_for_a_key_do_not_make_a_reader_leave_multicast() -> None:
    pace = RepairPace(0.0)
    for second in range(2 * REPAIRS_WITHOUT_ITEM_MAX):
        pace.note_message(second)
        pace.note_other_key(second)
        assert pace.next_step(second, is_missing=False)[0] is RepairStep.REPAIR
        pace.note_request()
    assert pace.next_step(second, is_missing=False)[0] is RepairStep.WAIT


def test_a_paused_reader_does_not_mistake_its_pause_for_silence() -> None:
    """In an earlier version, a program that read nothing for 3.5 s lost multicast for a minute, although datagrams
    came.
    """
    pace = RepairPace(0.0)
    pace.note_look(0.0)
    now_s = 10 * SILENT_S
    pace.note_look(now_s)
    assert pace.next_step(now_s, is_missing=False)[0] is RepairStep.WAIT
    while pace.next_step(now_s, is_missing=False)[0] is RepairStep.WAIT:  # the reader waits, and hears nothing
        now_s += BEAT_S_MAX
        pace.note_look(now_s)
    assert now_s - 10 * SILENT_S <= SILENT_S + BEAT_S_MAX
