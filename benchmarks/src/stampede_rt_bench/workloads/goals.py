"""The goals of the project, as ratios of two systems under the same workload in the same rounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from stampede_rt_bench.workloads.campaign import Results

GRPC, SOCKETS, SHARED = "Stampede RT, gRPC", "Stampede RT, sockets", "Stampede RT, shared memory"
EMBEDDED = "Stampede RT, embedded host"
REDIS, REDIS_UNIX, NATS = "Redis", "Redis, Unix socket", "NATS core"
ZENOH_ROUTER, ZENOH_PEER, ZENOH_SHARED = "Zenoh, router", "Zenoh, peer to peer", "Zenoh, shared memory"
PEERS = (REDIS, REDIS_UNIX, NATS, "NATS JetStream", ZENOH_ROUTER, ZENOH_PEER, ZENOH_SHARED)
Figure = Literal["p50_us", "items_per_second", "lost_share"]


@dataclass(frozen=True, kw_only=True)
class Goal:
    """The goal of one of our transports under one workload.

    The goal compares the `figure` of our transport with the figure of the best of `peers`: the ratio is at most or at
    least `bound`. Without peers the figure itself is at most `bound`. For a time or a loss, a smaller figure is better.
    For a rate, a greater figure is better.
    """

    workload: str
    ours: str
    figure: Figure
    bound: float
    peers: Sequence[str] = ()

    @property
    def is_rate(self) -> bool:
        """Whether a greater figure is better."""
        return self.figure == "items_per_second"

    @property
    def text(self) -> str:
        """The wanted ratio, in words."""
        if not self.peers:
            return f"at most {self.bound:g}"
        bound = f"1/{1 / self.bound:g}" if self.bound < 1 else f"{self.bound:g}"
        best = "the best of " if len(self.peers) > 1 else ""
        what = "the rate" if self.is_rate else "the time"
        names = "the peers" if set(self.peers) == set(PEERS) else " and ".join(self.peers)
        return f"{'at least' if self.is_rate else 'at most'} {bound} x {what} of {best}{names}"


_REDIS, _ZENOH = (REDIS, REDIS_UNIX), (ZENOH_ROUTER, ZENOH_PEER, ZENOH_SHARED)
_TIMES: Sequence[tuple[str, str, float, Sequence[str]]] = (
    ("put", SOCKETS, 1.2, _REDIS),
    ("newest", SOCKETS, 1.5, _REDIS),
    ("newest", SHARED, 1 / 30, _REDIS),
    ("frames-300kb-64", SOCKETS, 1, _ZENOH),
    ("frames-300kb-64", SHARED, 1 / 3, PEERS),
)
_RATES: Sequence[tuple[str, str, float, Sequence[str]]] = (
    ("interval", GRPC, 1.5, _REDIS),
    ("interval", SOCKETS, 2, _REDIS),
    ("stream-64b", GRPC, 2, (NATS,)),
    ("stream-64b", SOCKETS, 2, (NATS,)),
    ("stream-18kb", GRPC, 1, _REDIS),
    ("stream-18kb", GRPC, 1, (NATS,)),
    ("stream-18kb", SOCKETS, 2, _REDIS),
    ("stream-18kb", SOCKETS, 2, (NATS,)),
    ("stream-300kb", GRPC, 1, _REDIS),
    ("stream-300kb", GRPC, 1, (NATS,)),
    ("stream-300kb", SOCKETS, 1.5, _REDIS),
    ("stream-300kb", SOCKETS, 1.5, (NATS,)),
    ("stream-300kb", SHARED, 2, (ZENOH_SHARED,)),
    ("stream-300kb", EMBEDDED, 2, (ZENOH_SHARED,)),
)
_WITHOUT_LOSS = ("frames-18kb-32", "frames-300kb-16", "frames-300kb-64")


def goals() -> list[Goal]:
    """Return all goals: times, rates, and workloads in which no item may be lost."""
    kinds: Sequence[tuple[Figure, Sequence[tuple[str, str, float, Sequence[str]]]]] = (
        ("p50_us", _TIMES),
        ("items_per_second", _RATES),
        ("lost_share", [(workload, ours, 0, ()) for workload in _WITHOUT_LOSS for ours in (GRPC, SOCKETS, SHARED)]),
    )
    return [
        Goal(workload=workload, ours=ours, figure=figure, bound=bound, peers=peers)
        for figure, kind_goals in kinds
        for workload, ours, bound, peers in kind_goals
    ]


def measured(results: Results, goal: Goal) -> Spread | None:
    """Return the ratio of the goal in each round, or the figure without a peer; None if it was not measured."""
    by_system = next((systems for workload, systems in results.runs.items() if workload.name == goal.workload), {})
    values = {name: [float(getattr(one, goal.figure)) for one in runs] for name, runs in by_system.items()}
    if goal.ours not in values:
        return None
    if not goal.peers:
        return Spread.of(values[goal.ours])
    medians = {name: Spread.of(values[name]).median for name in goal.peers if name in values}
    if not all(medians.values()) or not medians:
        return None
    best = (max if goal.is_rate else min)(medians, key=lambda name: medians[name])
    return Spread.of([mine / theirs for mine, theirs in zip(values[goal.ours], values[best], strict=False) if theirs])


def table_of_goals(results: Results) -> Table:
    """Return a row for each goal: the ratio, or the figure without a peer, and whether the median reaches the goal."""
    titles = {workload.name: workload.title for workload in results.runs}
    table = Table(["Goals", "of", "wanted", "measured", "reached"])
    table.rows += [[titles[goal.workload], *_row(results, goal)] for goal in goals() if goal.workload in titles]
    return table


def _row(results: Results, goal: Goal) -> list[str]:
    found = measured(results, goal)
    cells = [goal.ours, goal.text + (" of the items lost" if goal.figure == "lost_share" else "")]
    if found is None:
        return [*cells, "not measured", ""]
    reached = found.median >= goal.bound if goal.is_rate else found.median <= goal.bound
    digits = 2 if found.median >= 0.1 or not found.median else 4
    return [*cells, spread(found, digits), "yes" if reached else "no"]
