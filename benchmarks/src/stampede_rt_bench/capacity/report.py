"""The report of `stampede bench capacity`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread
from stampede_rt_bench.workloads.campaign import FIGURES, Results
from stampede_rt_bench.workloads.catalogue import Workload

BYTES_PER_MB = 1_000_000


@dataclass(kw_only=True)
class CapacityReport:
    """The figures of one host, as far as they are measured. `system`: the name of the host in the results."""

    command: str
    machine: dict[str, str]
    system: str
    results: Results = field(default_factory=Results)
    memory: Mapping[str, Spread] = field(default_factory=dict)

    def rates(self) -> Table:
        """Return the table of the workloads: rates, times, and the CPU time of the services."""
        columns = ["one client, one reader", "items/s", "MB/s", "p50, us", "p99, us", "services' CPU, us/item"]
        table = Table(columns, [self._row(workload) for workload in self.results.runs])
        table.notes = ["p50 and p99: from the call of put to its acknowledgement, or to the reader."]
        return table

    def _row(self, workload: Workload) -> list[str]:
        def figure(name: str, digits: int = 0) -> str:
            return spread(self.results.spread(workload, self.system, name), digits)

        items = self.results.spread(workload, self.system, "items_per_second")
        times = ["", ""] if workload.kind == "stream" else [figure("p50_us"), figure("p99_us")]
        megabytes = f"{items.median * workload.item_bytes / BYTES_PER_MB:,.1f}"
        return [workload.title, spread(items, 0), megabytes, *times, figure("server_cpu_us_per_item", 1)]

    def memory_table(self) -> Table:
        """Return the table of memory."""
        table = Table(["resident memory of the host", "bytes"])
        table.rows += [[kind, spread(value, 0)] for kind, value in self.memory.items()]
        table.notes = ["Items with their payload, in a channel without a reader."]
        return table

    def tables(self) -> list[Table]:
        """Return the tables that have rows."""
        return [table for table in (self.rates(), self.memory_table()) if table.rows]

    def markdown(self) -> str:
        """Return the whole report as Markdown."""
        machine = "; ".join(f"{key}: {value}" for key, value in self.machine.items())
        conditions = f"Medians, with the least and the most in parentheses. Measured on: {machine}."
        parts = ["# Capacity of one host", f"`{self.command}`", conditions]
        parts += [table.markdown() for table in self.tables()]
        return "\n\n".join(parts + [f"Failed: {one.strip().splitlines()[0]}" for one in self.results.failures]) + "\n"

    def values(self) -> dict[str, object]:
        """Return the whole report as data for JSON."""
        workloads = {
            workload.name: {name: asdict(self.results.spread(workload, self.system, name)) for name in FIGURES}
            for workload in self.results.runs
        }
        memory = {kind: asdict(value) for kind, value in self.memory.items()}
        return {"command": self.command, "machine": self.machine, "works": workloads, "memory_bytes": memory}

    def write(self, folder: Path) -> None:
        """Write `capacity.md` and `capacity.json` into the folder. Raises OSError."""
        (folder / "capacity.md").write_text(self.markdown())
        (folder / "capacity.json").write_text(json.dumps(self.values(), indent=1) + "\n")
