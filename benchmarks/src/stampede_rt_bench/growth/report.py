"""Reports growth as Markdown, JSON and charts."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path

from stampede_rt_bench.charts import Axes, draw_lines
from stampede_rt_bench.growth.dimensions import DIMENSIONS, Costs, Dimension
from stampede_rt_bench.measuring import Spread
from stampede_rt_bench.tables import Table, spread

MEMORY = "bytes of memory a channel"  # in the table; the chart shows times only
LINEAR_RANGE = 10  # costs within this factor are drawn on a linear scale


@dataclass(kw_only=True)
class GrowthReport:
    """The costs measured so far, by the name of the dimension."""

    command: str
    machine: Mapping[str, str]
    runs: int
    costs: dict[str, Costs] = field(default_factory=dict)

    def add(self, name: str, costs: Costs, folder: Path) -> None:
        """Add the costs of one dimension, and write the report and their chart into `folder`. Raises OSError."""
        self.costs[name] = costs
        (folder / "growth.md").write_text(self.markdown())
        (folder / "growth.json").write_text(json.dumps(self.values(), indent=1) + "\n")
        _draw(folder / f"growth-{name}.png", DIMENSIONS[name], costs)

    def markdown(self) -> str:
        """Return the whole report as Markdown."""
        machine = "; ".join(f"{key}: {value}" for key, value in self.machine.items())
        conditions = f"{self.runs} runs; medians, with the least and the most in parentheses. Measured on: {machine}."
        tables = [
            f"### {DIMENSIONS[name].title}\n\n{table_of(name, costs).markdown()}" for name, costs in self.costs.items()
        ]
        return "\n\n".join(["# Growth", f"`{self.command}`", conditions, *tables]) + "\n"

    def values(self) -> dict[str, object]:
        """Return the whole report as data for JSON."""
        return {
            "command": self.command,
            "machine": dict(self.machine),
            "runs": self.runs,
            "growth": {name: _growth_of(costs) for name, costs in self.costs.items()},
        }


def operations_of(costs: Costs) -> list[str]:
    """Return the operations of all sizes."""
    return list(dict.fromkeys(operation for by_operation in costs.values() for operation in by_operation))


def line_of(costs: Costs, operation: str) -> list[tuple[float, Spread]]:
    """Return the cost of an operation at each size at which it was measured."""
    return [(size, found[operation]) for size, found in costs.items() if operation in found]


def steepest(costs: Costs, operation: str) -> float | None:
    """Return the exponent of the steepest step: 0 for a constant cost, 1 for a cost in proportion to the size.

    None if there is only one size. A difference of two measurements may be 0 or less; such a cost has no exponent.
    """
    line = [(size, cost) for size, cost in line_of(costs, operation) if cost.median > 0]
    return max(
        (math.log(after.over(before)) / math.log(more / less) for (less, before), (more, after) in pairwise(line)),
        default=None,
    )


def table_of(name: str, costs: Costs) -> Table:
    """Return the costs at each size, and how fast each cost grows."""
    dimension, operations = DIMENSIONS[name], operations_of(costs)
    table = Table([dimension.what, *operations])
    for size, found in costs.items():
        table.rows.append([f"{size:,}", *(_cell(operation, found.get(operation)) for operation in operations)])
    table.notes = [dimension.about]
    growing = {operation: steepest(costs, operation) for operation in operations if operation != MEMORY}
    exponents = ", ".join(f"{operation} {one:.2f}" for operation, one in growing.items() if one is not None)
    if exponents:
        table.notes.append(f"Exponent of the steepest step (0: constant, 1: in proportion): {exponents}.")
    return table


def _cell(operation: str, cost: Spread | None) -> str:
    if cost is None:
        return ""
    return f"{cost.median:,.0f}" if operation == MEMORY else spread(cost)


def _draw(file: Path, dimension: Dimension, costs: Costs) -> None:
    lines = {operation: line_of(costs, operation) for operation in operations_of(costs) if operation != MEMORY}
    medians = [cost.median for line in lines.values() for _, cost in line]
    log_y = max(medians) > LINEAR_RANGE * min(medians)
    axes = Axes(title=dimension.title, x=dimension.what, y="microseconds of CPU time", log_y=log_y)
    draw_lines(file, axes, lines)


def _growth_of(costs: Costs) -> dict[str, object]:
    return {
        "costs": [
            {"size": size, **{operation: asdict(cost) for operation, cost in by_operation.items()}}
            for size, by_operation in costs.items()
        ],
        "steepest": {operation: steepest(costs, operation) for operation in operations_of(costs)},
    }
