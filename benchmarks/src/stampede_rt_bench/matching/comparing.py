"""Makes the table of every scenario with our match and both synchronisers of ROS message_filters."""

from __future__ import annotations

from stampede_rt_bench.matching import approximate_time, message_filters, ours
from stampede_rt_bench.matching.recording import NANOS_PER_MS, SCENARIOS, record
from stampede_rt_bench.matching.sets import Judgement, judge
from stampede_rt_bench.tables import Cell, Table, number

COLUMNS = (
    *("inputs", "synchroniser", "possible", "right", "wrong", "unmatched", "reported"),
    *("delay p50 ms", "p99", "max"),
)


def compare(seconds: int, seed: int) -> Table:
    """Replay every scenario, and return the table. `seconds` is the length of each recording."""
    synchronisers = {"g.match": ours.replay}
    peers = {"filters, Python": message_filters, "filters, C++": approximate_time}
    synchronisers |= {name: peer.replay for name, peer in peers.items() if peer.is_installed()}
    table = Table(COLUMNS)
    for conditions in SCENARIOS:
        arrivals = record(conditions, seconds, seed)
        for name, replay in synchronisers.items():
            tolerance = conditions.tolerance_nanos
            judgement = judge(replay(arrivals, tolerance), arrivals, tolerance)
            table.rows.append((conditions.name, name, *_cells(judgement)))
    table.notes = [
        "filters: ROS message_filters, the Python ApproximateTimeSynchronizer and the C++ ApproximateTime policy.",
        f"{seconds} s, seed {seed}; lidar 10 Hz (the reference), camera 30 Hz, radar 20 Hz; tolerance 20 ms.",
        "possible: the sets of nearest items in the whole recording. right: returned sets that are among these.",
        "wrong: other returned sets. unmatched: lidar items without a returned set. reported: those that the program",
        "reports ('-': it cannot report them). delay: from the arrival of a set's last item until its return.",
    ]
    table.notes += [
        f"{name}: not here; Debian has it as {peer.PACKAGE}."
        for name, peer in peers.items()
        if name not in synchronisers
    ]
    return table


def _cells(judgement: Judgement) -> tuple[str, ...]:
    delays = judgement.delays_nanos
    shown = [
        number(delays[int(share * (len(delays) - 1))] / NANOS_PER_MS, 1) if delays else Cell("-", None)
        for share in (0.5, 0.99, 1)
    ]
    counts = (judgement.possible, judgement.right, judgement.wrong, judgement.unmatched)
    return (
        *map(number, counts),
        Cell("-", None) if judgement.reported_count is None else number(judgement.reported_count),
        *shown,
    )
