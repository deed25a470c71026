"""Figure 5 of the paper: the frames that consumers of one channel drop, by the number of consumers.

A producer puts frames at 30 a second. Each consumer is a process. It gets the newest frame again and again, and waits
for the next frame if it already has the newest. Here the channel's host is a process of its own, and all processes
share this machine. In the paper the producer holds the channel, and machines with up to four consumers share a network.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

from stampede_rt_bench.charts import Axes, Points, draw_lines
from stampede_rt_bench.measuring import Effort, Spread
from stampede_rt_bench.peers.ours import StampedeClient, StampedeRt
from stampede_rt_bench.tables import Cell, Table, number, spread
from stampede_rt_bench.workloads.catalogue import FRAMES_PER_SECOND, LARGE, MEDIUM, frames, size
from stampede_rt_bench.workloads.interface import Receiver, RunningServer, WorkloadNeeds
from stampede_rt_bench.workloads.run import count_lost

CONSUMERS = {MEDIUM: (8, 16, 32), LARGE: (4, 8, 12, 16)}
PAPER_FRAMES = 2312
WAIT_SECONDS = 0.1


class PaperDrops(NamedTuple):
    """The figures in the text of the paper.

    `by_all`: the frames that all consumers dropped, on average. `most`: the most frames that one consumer dropped in a
    run. `most_frames`: the same figure as a number; None if the paper does not state it.
    """

    by_all: str
    most: str
    most_frames: int | None


IN_PAPER = {
    (MEDIUM, 32): PaperDrops("under 7", "4", 4),
    (LARGE, 12): PaperDrops("9.5", "not told", None),
    (LARGE, 16): PaperDrops("about 17 % of all", "549", 549),
}
NOT_REPORTED = PaperDrops("", "", None)


@dataclass(frozen=True)
class NewestByTurns(StampedeRt):
    """Stampede RT with consumers that get the newest item, and no subscription."""

    def connect(self, served: RunningServer, needs: WorkloadNeeds) -> StampedeClient:
        """Return a client with a new connection."""
        return NewestClient(served.address, needs, self.transport)


class NewestClient(StampedeClient):
    """Reads as the paper's consumers do."""

    def subscribe(self, receiver: Receiver) -> None:
        """Get the newest item again and again, each time later than the last one. Blocks until such an item comes."""
        last = self._channel.newest()
        receiver.ready()
        while not receiver.ended():
            item = self._channel.newest(after=last, timeout=WAIT_SECONDS)
            if item is not None:
                receiver.take(item.time, item.seq, item.payload or b"")
                last = item


def measure(effort: Effort, chart: Path) -> Table:
    """Make the table and the chart of dropped frames."""
    columns = [
        "frames of",
        "consumers",
        "dropped by all",
        "most by one, any run",
        "by all, paper",
        "most by one, paper",
    ]
    table = Table(columns)
    lines: dict[str, list[tuple[float, Spread]]] = {}
    for item_bytes, counts in CONSUMERS.items():
        for consumers in counts:
            workload = frames(item_bytes, consumers, effort.frames)
            runs = [count_lost(NewestByTurns(), workload) for _ in range(effort.runs)]
            table.rows.append(_row(item_bytes, consumers, runs))
            most = Spread.of([100 * max(lost) / effort.frames for lost in runs])
            lines.setdefault(f"{size(item_bytes)}, ours", []).append((consumers, most))
    draw_lines(chart, _axes(effort), {**lines, **_paper_lines()})
    table.notes = _notes(effort)
    return table


def _row(item_bytes: int, consumers: int, runs: Sequence[Sequence[int]]) -> list[str]:
    paper = IN_PAPER.get((item_bytes, consumers), NOT_REPORTED)
    by_all = Spread.of([sum(lost) for lost in runs])
    mean = statistics.fmean(sum(lost) for lost in runs)
    return [
        size(item_bytes),
        number(consumers),
        Cell(f"{mean:,.1f}; {spread(by_all, 0)}", {"mean": mean, **asdict(by_all)}),
        number(max(max(lost) for lost in runs)),
        paper.by_all,
        Cell(paper.most, paper.most_frames),
    ]


def _axes(effort: Effort) -> Axes:
    title = f"Frames that one consumer dropped at the most, of {effort.frames:,} at {FRAMES_PER_SECOND} a second"
    return Axes(title=title, x="consumers of one channel, each a process", y="% of the frames", log_x=False)


def _paper_lines() -> dict[str, Points]:
    lines: dict[str, list[tuple[float, Spread]]] = {}
    for (item_bytes, consumers), paper in IN_PAPER.items():
        if paper.most_frames is not None:
            percent = 100 * paper.most_frames / PAPER_FRAMES
            lines.setdefault(f"{size(item_bytes)}, paper", []).append((consumers, Spread.of([percent])))
    return dict(lines)


def _notes(effort: Effort) -> list[str]:
    return [
        f"{effort.runs} runs of {effort.frames:,} frames; dropped by all: mean; median (least to most) of the runs.",
        f"Paper: 5 runs of {PAPER_FRAMES:,} frames, Gigabit Ethernet, dual 3.06 GHz Xeons with up to 4 consumers each;",
        "its text gives these figures, our copy lacks its graphs.",
    ]
