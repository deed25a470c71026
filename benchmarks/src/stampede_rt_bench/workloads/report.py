"""Writes the results of a comparison as Markdown, JSON and charts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from stampede_rt_bench.charts import Axes, draw_bars, draw_lines
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from stampede_rt_bench.workloads.campaign import FIGURES, Results
from stampede_rt_bench.workloads.catalogue import FRAMES_PER_SECOND, Workload, size
from stampede_rt_bench.workloads.goals import table_of_goals

LOST_SHARE_MAX = 0.01
CHARTED = {
    "put": "operations", "newest": "operations", "interval": "operations", "stream": "streams", "latency": "latency",
}  # fmt: skip
CHARTS = {
    "operations": ("Median time of one operation", "microseconds"),
    "streams": ("Items from a producer through a server to a reader", "items a second"),
    "latency": ("Median time from put to reader", "microseconds"),
}


@dataclass(kw_only=True)
class Report:
    """The report of one campaign. `ours`: the system to which it compares the others. `limits`: the limits' names."""

    name: str
    title: str
    command: str
    machine: Mapping[str, str]
    rounds: int
    seconds: float
    ours: str | None = None
    limits: Sequence[str] = ()
    unsupported: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    tables: list[tuple[str, Table]] = field(default_factory=list)

    def table(self, results: Results, workload: Workload) -> Table:
        """Return the table of all systems that ran the workload: times or rates, CPU time, losses, comparison."""
        times = [] if workload.kind == "stream" else ["p50, us", "p99, us", "p99.9, us"]
        columns = [workload.title, *times, "items/s", "CPU us/item"]
        columns += [] if workload.is_operation else ["lost, %"]
        columns += ["ours, times as fast"] if self.ours else []
        columns += [f"of {limit}" for limit in self.limits]
        table = Table(columns)
        for system in results.runs.get(workload, {}):
            table.rows.append(self._row(results, workload, system))
        table.notes = [
            f"{name}: {why[workload.kind]}." for name, why in self.unsupported.items() if workload.kind in why
        ]
        return table

    def _row(self, results: Results, workload: Workload, system: str) -> list[str]:
        def figure(name: str, digits: int, factor: float = 1) -> str:
            value = results.spread(workload, system, name)
            return spread(Spread(value.median * factor, value.least * factor, value.most * factor), digits)

        cells = [system]
        if workload.kind != "stream":
            cells += [figure("p50_us", 0), figure("p99_us", 0), figure("p999_us", 0)]
        cells += [figure("items_per_second", 0), figure("cpu_us_per_item", 2)]
        if not workload.is_operation:
            cells.append(figure("lost_share", 2, factor=100))
        measured = results.runs[workload]
        if self.ours:
            same = self.ours not in measured or system == self.ours
            cells.append("" if same else f"{results.speed(workload, self.ours, system):.2g}")
        for limit in self.limits:
            compared = limit in measured and system not in self.limits
            cells.append(f"{results.speed(workload, system, limit):.2g}" if compared else "")
        return cells

    def readers(self, results: Results) -> list[tuple[str, Table]]:
        """Return a table for each size of frames: the most readers that each system serves with under 1 % lost."""
        workloads = [workload for workload in results.runs if workload.kind == "frames"]
        tables = []
        for item_bytes in dict.fromkeys(workload.item_bytes for workload in workloads):
            same_size_workloads = [workload for workload in workloads if workload.item_bytes == item_bytes]
            title = f"Most readers of {size(item_bytes)} at {FRAMES_PER_SECOND} fps with under 1 % lost"
            table = Table([title, "readers"])
            for system in dict.fromkeys(name for workload in same_size_workloads for name in results.runs[workload]):
                most = results.most_readers(same_size_workloads, system, LOST_SHARE_MAX)
                table.rows.append([system, f"{most} of {same_size_workloads[-1].readers} tried" if most else "none"])
            tables.append((title, table))
        return tables

    def write(self, results: Results, folder: Path) -> None:
        """Write the report into `folder` as Markdown, JSON and charts. Raises OSError."""
        (folder / f"{self.name}.md").write_text(self.markdown(results))
        (folder / f"{self.name}.json").write_text(json.dumps(self.values(results), indent=1) + "\n")
        self._draw(results, folder)

    def markdown(self, results: Results) -> str:
        """Return the whole report as Markdown."""
        parts = [f"# {self.title}", f"`{self.command}`", self._conditions()]
        parts += [table_of_goals(results).markdown()] if self.ours else []
        parts += [table.markdown() for _, table in self.tables]
        parts += [self.table(results, workload).markdown() for workload in results.runs]
        parts += [table.markdown() for _, table in self.readers(results)]
        parts += [f"{system} was not measured: {why}." for system, why in results.absent.items()]
        parts += [f"Failed: {failure.strip().splitlines()[0]}" for failure in results.failures]
        return "\n\n".join(parts) + "\n"

    def _conditions(self) -> str:
        machine = "; ".join(f"{key}: {value}" for key, value in self.machine.items())
        ratios = '"Of" a limit: the speed of the row as a share of the limit.' if self.limits else ""
        if self.ours:
            ratios = f'"Ours, times as fast": {self.ours} against the system of the row. {ratios}'
        return (
            f"{self.rounds} runs of {self.seconds:g} s in steady state, the systems alternately, each with a fresh "
            f"server. Medians, with the least and the most in parentheses. CPU time is that of all processes together. "
            f"{ratios}\n\nMeasured on: {machine}."
        )

    def values(self, results: Results) -> dict[str, object]:
        """Return the whole report as data for JSON, with the results of every run."""
        return {
            "command": self.command,
            "machine": dict(self.machine),
            "rounds": self.rounds,
            "seconds": self.seconds,
            "works": [
                {
                    **asdict(workload),
                    "systems": {
                        system: {"runs": [asdict(one) for one in runs], **self._spreads(results, workload, system)}
                        for system, runs in by_system.items()
                    },
                }
                for workload, by_system in results.runs.items()
            ],
            "tables": {title: {"columns": table.columns, "rows": table.rows} for title, table in self.tables},
            "lacks": {name: dict(why) for name, why in self.unsupported.items()},
            "absent": results.absent,
            "failures": results.failures,
        }

    @staticmethod
    def _spreads(results: Results, workload: Workload, system: str) -> dict[str, object]:
        return {figure: asdict(results.spread(workload, system, figure)) for figure in FIGURES}

    def _draw(self, results: Results, folder: Path) -> None:
        for chart, (title, unit) in CHARTS.items():
            workloads = [workload for workload in results.runs if CHARTED.get(workload.kind) == chart]
            if workloads:
                bars = {
                    workload.title: {system: results.main_figure(workload, system) for system in results.runs[workload]}
                    for workload in workloads
                }
                draw_bars(folder / f"{self.name}-{chart}.png", title, unit, bars)
        frames = [workload for workload in results.runs if workload.kind == "frames"]
        for item_bytes in dict.fromkeys(workload.item_bytes for workload in frames):
            self._draw_readers(results, [workload for workload in frames if workload.item_bytes == item_bytes], folder)

    def _draw_readers(self, results: Results, workloads: Sequence[Workload], folder: Path) -> None:
        systems = dict.fromkeys(system for workload in workloads for system in results.runs[workload])
        lines = {
            system: [
                (float(workload.readers), _in_ms(results.spread(workload, system, "p99_us")))
                for workload in workloads
                if system in results.runs[workload]
            ]
            for system in systems
        }
        label = size(workloads[0].item_bytes)
        axes = Axes(
            title=f"{label} at {FRAMES_PER_SECOND} frames a second: p99 of the worst reader",
            x="readers",
            y="milliseconds from put to reader",
            log_y=True,
        )
        draw_lines(folder / f"{self.name}-frames-{label.replace(' ', '').lower()}.png", axes, lines)


def _in_ms(value: Spread) -> Spread:
    return Spread(value.median / 1000, value.least / 1000, value.most / 1000)
