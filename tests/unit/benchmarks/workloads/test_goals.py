"""The table of the goals, without measuring anything."""

from __future__ import annotations

from stampede_rt_bench.comparison import SYSTEMS
from stampede_rt_bench.workloads.campaign import Results
from stampede_rt_bench.workloads.catalogue import workloads
from stampede_rt_bench.workloads.goals import REDIS, REDIS_UNIX, SHARED, SOCKETS, goals, table_of_goals
from stampede_rt_bench.workloads.run import RunResult

WORKLOADS = {workload.name: workload for workload in workloads()}


def measured(rate: float = 1, p50_us: float = 1, lost: float = 0) -> RunResult:
    return RunResult(seconds=1, items_per_second=rate, cpu_us_per_item=1, p50_us=p50_us, p99_us=1, lost_share=lost)


def rows(results: Results, ours: str) -> list[list[str]]:
    return [[*row] for row in table_of_goals(results).rows if row[1] == ours]


def test_each_goal_names_a_workload_and_systems_that_can_run_it() -> None:
    systems = {system.name: system for system in SYSTEMS.values()}
    assert goals()
    for goal in goals():
        for name in (goal.ours, *goal.peers):
            assert WORKLOADS[goal.workload].kind not in systems[name].unsupported


def test_a_ratio_compares_each_round_with_the_best_peer() -> None:
    runs = {
        SOCKETS: [measured(p50_us=value) for value in (30, 24, 36)],
        REDIS: [measured(p50_us=90)] * 3,
        REDIS_UNIX: [measured(p50_us=value) for value in (20, 20, 40)],
    }
    [row] = rows(Results(runs={WORKLOADS["put"]: runs}), SOCKETS)
    wanted = "at most 1.2 x the time of the best of Redis and Redis, Unix socket"
    assert row[2:] == [wanted, "1.20 (0.90 to 1.50)", "yes"]
    runs[SOCKETS] = [measured(p50_us=value) for value in (30, 26, 50)]
    assert rows(Results(runs={WORKLOADS["put"]: runs}), SOCKETS)[0][3:] == ["1.30 (1.25 to 1.50)", "no"]


def test_more_is_better_for_a_rate_and_the_median_round_may_lose_no_item() -> None:
    stream = {SHARED: [measured(rate=10)], "Zenoh, shared memory": [measured(rate=4)]}
    frames = {SHARED: [measured(lost=0.01), measured(), measured()]}
    found = Results(runs={WORKLOADS["stream-300kb"]: stream, WORKLOADS["frames-300kb-16"]: frames})
    assert [row[2:] for row in rows(found, SHARED)] == [
        ["at least 2 x the rate of Zenoh, shared memory", "2.50 (2.50 to 2.50)", "yes"],
        ["at most 0 of the items lost", "0.00 (0.00 to 0.01)", "yes"],
    ]


def test_a_goal_whose_peer_was_not_measured_is_marked() -> None:
    found = rows(Results(runs={WORKLOADS["newest"]: {SHARED: [measured()]}}), SHARED)
    assert [row[2:] for row in found] == [
        ["at most 1/30 x the time of the best of Redis and Redis, Unix socket", "not measured", ""]
    ]
