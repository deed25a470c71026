"""`stampede bench paper`: measures what the paper measured, prints tables, draws charts."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from stampede_rt_bench.measuring import Effort
from stampede_rt_bench.paper import get_cost, interval_cost, memory_cost
from stampede_rt_bench.tables import Table

EXIT_FAILED, EXIT_INTERRUPTED = 1, 130
ITEMS_MAX = 10_000_000
RUNS_MAX = 100

Figure = Callable[[Effort, Path], Table]
FIGURES: dict[str, tuple[str, Figure]] = {
    "get": ("cost of a get by time as a channel grows (Figure 4)", get_cost.measure),
    "interval": ("cost of an interval get as it returns more (section 6)", interval_cost.measure),
    "memory": ("memory of held items of 64 B", memory_cost.measure),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks. Returns the exit code: 0, 1 if charts cannot be written, 130 after Ctrl-C."""
    arguments = _parser().parse_args(sys.argv[1:] if argv is None else argv)
    folder: Path = arguments.out
    try:
        folder.mkdir(parents=True, exist_ok=True)
        effort = Effort(items_max=arguments.items_max, runs=arguments.runs)
        for name in arguments.figure or FIGURES:
            title, measure = FIGURES[name]
            print(f"\n{title[0].upper()}{title[1:]}", flush=True)
            measure(effort, folder / f"{name}.png").print()
    except OSError as error:
        print(
            f"stampede bench: {error.filename or folder}: {error.strerror}; name another folder with --out",
            file=sys.stderr,
        )
        return EXIT_FAILED
    except KeyboardInterrupt:
        print("\nstampede bench: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    return 0


def _parser() -> argparse.ArgumentParser:
    listing = "\n".join(f"  {name:<10}{title}" for name, (title, _) in FIGURES.items())
    parser = argparse.ArgumentParser(prog="stampede bench", description="Benchmarks, with their peers beside them.")
    kinds = parser.add_subparsers(dest="kind", metavar="NAME", required=True)
    paper = kinds.add_parser(
        "paper",
        description=f"The figures of the paper, measured on this machine:\n\n{listing}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        help="the figures of the paper",
    )
    paper.add_argument("--figure", action="append", choices=FIGURES, help="this one only; may be repeated")
    paper.add_argument(
        "--items-max",
        type=_between(1000, ITEMS_MAX),
        default=ITEMS_MAX,
        metavar="N",
        help="the largest channel (default: 10,000,000, which takes 4 GiB and some minutes)",
    )
    paper.add_argument(
        "--runs", type=_between(1, RUNS_MAX), default=5, metavar="N", help="how often each figure is taken (default: 5)"
    )
    paper.add_argument(
        "--out", type=Path, default=Path("out/bench"), metavar="DIR", help="where the charts go (default: out/bench)"
    )
    return parser


def _between(least: int, most: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number from {least} to {most}")
        return int(text)

    return number
