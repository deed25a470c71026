"""The comparison with message_filters judges sets by the whole recording. No time is judged here."""

from __future__ import annotations

import json

import pytest

from stampede_rt_bench import app
from stampede_rt_bench.matching import approximate_time, message_filters, ours
from stampede_rt_bench.matching.comparing import compare
from stampede_rt_bench.matching.recording import NANOS_PER_MS, SCENARIOS, Arrival, nearest_sets, record, times_of
from stampede_rt_bench.matching.sets import FoundSet, Replay, judge
from tests.support.command_line.documented_fields import require_fields

TOLERANCE = 20 * NANOS_PER_MS


def test_a_recording_is_the_same_for_one_seed_and_another_for_the_next() -> None:
    assert record(SCENARIOS[0], 15, 1) == record(SCENARIOS[0], 15, 1) != record(SCENARIOS[0], 15, 2)


def test_lost_items_and_silence_are_really_missing() -> None:
    whole, lossy, _, silent, *_ = (record(conditions, 15, 1) for conditions in SCENARIOS)
    assert len(lossy) < len(whole)
    assert len(times_of(silent, "camera")) == len(times_of(whole, "camera")) - 60


def test_a_complete_view_finds_the_nearest_and_the_earlier_of_two() -> None:
    ms = NANOS_PER_MS
    arrivals = [Arrival(1, "lidar", 100 * ms), Arrival(2, "camera", 95 * ms), Arrival(3, "camera", 105 * ms)]
    arrivals += [Arrival(4, "radar", 80 * ms), Arrival(5, "radar", 119 * ms)]
    assert nearest_sets(arrivals, TOLERANCE) == {100 * ms: {"camera": 95 * ms, "radar": 119 * ms}}
    assert nearest_sets(arrivals, 10 * ms) == {}


def test_a_set_that_is_not_the_nearest_counts_as_wrong() -> None:
    ms = NANOS_PER_MS
    arrivals = [Arrival(1, "lidar", 100 * ms), Arrival(2, "camera", 90 * ms), Arrival(3, "camera", 101 * ms)]
    arrivals += [Arrival(4, "radar", 100 * ms)]
    wrong = FoundSet(given=10, reference=100 * ms, times={"camera": 90 * ms, "radar": 100 * ms})
    judgement = judge(Replay(sets=[wrong], reported_unmatched=None), arrivals, TOLERANCE)
    assert (judgement.possible, judgement.right, judgement.wrong, judgement.unmatched) == (1, 0, 1, 0)
    assert judgement.delays_nanos == [6]


@pytest.mark.parametrize("conditions", SCENARIOS, ids=lambda one: one.name)
def test_our_match_gives_no_wrong_set_and_reports_every_item_without_a_set(conditions: object) -> None:
    found = next(one for one in SCENARIOS if one is conditions)
    arrivals = record(found, 15, 3)
    judgement = judge(ours.replay(arrivals, found.tolerance_nanos), arrivals, found.tolerance_nanos)
    assert judgement.wrong == 0
    assert judgement.reported_count is not None
    # The last items are not decided when the recording ends.
    assert 0 <= judgement.unmatched - judgement.reported_count <= 2


def test_the_table_has_every_synchroniser_or_advice_how_to_get_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    table = compare(15, 1)
    monkeypatch.setattr(app, "compare", lambda seconds, seed: table)
    assert app.main(["matching", "--output", "json"]) == 0
    printed = capsys.readouterr().out
    require_fields("bench matching", printed)
    assert sum(row["synchroniser"] == "g.match" for row in json.loads(printed)["rows"]) == len(SCENARIOS)
    assert app.main(["matching", "--seconds", "15"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("g.match") == len(SCENARIOS)
    for name, peer in (("filters, Python", message_filters), ("filters, C++", approximate_time)):
        assert printed.count(f"{name}  ") == (len(SCENARIOS) if peer.is_installed() else 0)
        assert (f"Debian has it as {peer.PACKAGE}" in printed) != peer.is_installed()
