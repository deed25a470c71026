"""Events that are logged once, however often they happen."""

from __future__ import annotations

from stampede_rt_supernode.replication.network.reports import REPEAT_SECONDS_MIN, REPORTS_MAX, ReportLimiter


def test_two_alternating_reasons_are_logged_once_each() -> None:
    reports = ReportLimiter()
    logged = [reports.is_due(("s3", reason), now) for now in range(10) for reason in ("refused", "nobody there")]
    assert logged == [True, True] + 18 * [False]


def test_a_lasting_problem_is_reported_again_after_a_while() -> None:
    reports = ReportLimiter()
    assert reports.is_due("down", 0.0)
    assert not reports.is_due("down", REPEAT_SECONDS_MIN - 1)
    assert reports.is_due("down", REPEAT_SECONDS_MIN)


def test_the_number_of_kept_problems_is_limited() -> None:
    reports = ReportLimiter()
    for number in range(3 * REPORTS_MAX):
        assert reports.is_due(number, 0.0)
    assert len(reports._logged_at) == REPORTS_MAX
