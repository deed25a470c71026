"""The log lines of a front-end about supernodes: one for each change."""

from __future__ import annotations

from stampede_rt_frontend.roster import ProbeAnswer, SupernodeRoster
from stampede_rt_frontend.status_log import START_SECONDS, StatusLog

LATER_S = 100.0 + START_SECONDS


def answer(*, ready: bool) -> ProbeAnswer:
    return ProbeAnswer(supernode_id="s", cluster_id="c1", ready=ready, round_trip_nanos=10)


def started() -> tuple[SupernodeRoster, StatusLog]:
    """A front-end that began at the time 100: its roster of supernodes, and its log of their changes."""
    roster, status_log = SupernodeRoster(("a:1", "b:1")), StatusLog()
    assert list(status_log.changes(roster, 100.0)) == []
    return roster, status_log


def test_unreachable_supernodes_are_not_reported_in_the_first_seconds() -> None:
    roster, status_log = started()
    for target in roster.targets():
        roster.note_failure(target, "connection refused")
    assert list(status_log.changes(roster, 101.0)) == []
    assert len(list(status_log.changes(roster, LATER_S))) == 3


def test_the_loss_of_a_supernode_and_its_return_are_reported_once_each() -> None:
    roster, status_log = started()
    assert list(status_log.changes(roster, LATER_S)) == []
    roster.note_answer("a:1", answer(ready=True))
    assert [note.text for note in status_log.changes(roster, LATER_S)] == [
        "a supernode can serve",
        "the directory can serve: callers can connect",
    ]
    for _ in range(3):
        roster.note_failure("b:1", "connection refused")
        changes = list(status_log.changes(roster, LATER_S))
    assert changes == []
    roster.note_answer("b:1", answer(ready=True))
    assert [(note.text, note.facts) for note in status_log.changes(roster, LATER_S)] == [
        ("a supernode can serve", {"supernode": "b:1"})
    ]


def test_the_loss_of_the_majority_and_its_return_are_reported_once_each() -> None:
    roster, status_log = started()
    for target in roster.targets():
        roster.note_answer(target, answer(ready=True))
    list(status_log.changes(roster, LATER_S))
    lines: list[str] = []
    for _ in range(3):
        roster.note_failure("b:1", "connection refused")
        roster.note_answer("a:1", answer(ready=False))
        lines += [f"{note.text} {note.facts.get('why', '')}" for note in status_log.changes(roster, LATER_S)]
    assert [line.partition(":")[0] for line in lines] == [
        "a supernode cannot serve it knows no leader with a majority",
        "a supernode cannot serve connection refused",
        "no supernode can serve this front-end",
    ]
    roster.note_answer("a:1", answer(ready=True))
    assert [(note.is_well, note.is_return) for note in status_log.changes(roster, LATER_S)] == [
        (True, True),
        (True, True),
    ]


def test_the_first_ready_answer_of_a_supernode_is_no_return() -> None:
    roster, status_log = started()
    roster.note_answer("a:1", answer(ready=True))
    assert [note.is_return for note in status_log.changes(roster, 101.0)] == [False, False]


def test_at_the_start_a_front_end_tries_all_supernodes_before_it_reports_that_none_can_serve() -> None:
    roster, status_log = started()
    roster.note_failure("a:1", "connection refused")
    assert [note.facts for note in status_log.changes(roster, LATER_S)] == [
        {"supernode": "a:1", "why": "connection refused"}
    ]
    roster.note_failure("b:1", "connection refused")
    assert [note.text.partition(":")[0] for note in status_log.changes(roster, LATER_S)][
        -1
    ] == "no supernode can serve this front-end"
