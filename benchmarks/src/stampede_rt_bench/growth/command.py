"""`stampede bench growth`."""

from __future__ import annotations

import argparse
from pathlib import Path

from stampede_rt_bench.growth.dimensions import DIMENSIONS, Sizes
from stampede_rt_bench.growth.report import GrowthReport, table_of
from stampede_rt_bench.machine import describe
from stampede_rt_bench.printing import announce, finish, show


def measure_growth(arguments: argparse.Namespace) -> int:
    """Measure the chosen dimensions, and report each as soon as it is measured. Returns 0. Raises OSError."""
    folder: Path = arguments.out
    folder.mkdir(parents=True, exist_ok=True)
    sizes = Sizes(
        channels_max=arguments.channels_max,
        items_max=arguments.items_max,
        readers_max=arguments.readers_max,
        groups_max=arguments.groups_max,
        runs=arguments.runs,
        operations=arguments.operations,
    )
    names = arguments.of or [*DIMENSIONS]
    command = (
        f"stampede bench growth --runs {sizes.runs} --operations {sizes.operations} --channels-max {sizes.channels_max}"
    )
    command += f" --items-max {sizes.items_max} --readers-max {sizes.readers_max} --groups-max {sizes.groups_max}"
    command += "".join(f" --of {name}" for name in arguments.of or [])
    report = GrowthReport(command=command, machine=describe(("grpcio",)), runs=sizes.runs)
    for name in names:
        announce(DIMENSIONS[name].title, arguments.output)
        costs = DIMENSIONS[name].measure(sizes)
        show(table_of(name, costs), arguments.output)
        report.add(name, costs, folder)
    finish(report.values(), f"\nThe report is in {folder}: growth.md, growth.json and the charts.", arguments.output)
    return 0
