"""`stampede bench`: measures figures of the paper, growth, capacity, limits, and other systems under the same load."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from stampede_rt.administration.output_forms import add_output
from stampede_rt.cli.interrupts import unwinding
from stampede_rt.cli.output import print_rows
from stampede_rt.escaping import TerminalParser, escaped
from stampede_rt_bench.capacity.command import MEMORY, capacity_workloads, measure_capacity
from stampede_rt_bench.comparison import SYSTEMS, measure_limits, measure_peers
from stampede_rt_bench.growth.command import measure_growth
from stampede_rt_bench.growth.dimensions import DIMENSIONS
from stampede_rt_bench.matching.comparing import compare
from stampede_rt_bench.measuring import Effort
from stampede_rt_bench.paper import contention, get_cost, interval_cost, memory_cost, proxies, skew, visibility
from stampede_rt_bench.printing import announce, finish, show
from stampede_rt_bench.tables import Table
from stampede_rt_bench.workloads.catalogue import READERS, workloads
from stampede_rt_bench.workloads.processes import ServerFailed
from stampede_rt_bench.workloads.run import RunFailed

EXIT_FAILED, EXIT_INTERRUPTED = 1, 130
ITEMS_MAX = 10_000_000
RUNS_MAX = 100
FRAMES_MIN, FRAMES_MAX = 10, 100_000
READERS_MAX = 256
CHANNELS_MAX = 100_000
SUBSCRIPTIONS_MAX = 4096
GROUPS_MAX = 750  # the most groups with the same channel that one client may make
SECONDS_MIN, SECONDS_MAX = 0.1, 600.0

Figure = Callable[[Effort, Path], Table]
FIGURES: dict[str, tuple[str, Figure]] = {
    "get": ("cost of a get by time as a channel grows, in the core and over gRPC (Figure 4)", get_cost.measure),
    "interval": ("cost of an interval get as it returns more (section 6)", interval_cost.measure),
    "contention": ("frames dropped by consumers of one channel (Figure 5)", contention.measure),
    "proxies": ("frames that readers of one channel lose, without proxies and with them (Figure 6)", proxies.measure),
    "visibility": ("what a group of text and audio shows (Figure 3)", visibility.measure),
    "skew": ("skew between consumers with a group and without (Figure 7)", skew.measure),
    "memory": ("memory of held items of 64 B", memory_cost.measure),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks. Returns the exit code: 0; 1 if a run fails or a file cannot be written; 130 after Ctrl-C."""
    parser = _parser()
    arguments = parser.parse_args(sys.argv[1:] if argv is None else argv)
    if arguments.kind is None:
        parser.print_help()
        return 0
    run: Callable[[argparse.Namespace], int] = arguments.run
    try:
        with unwinding(signal.SIGINT, signal.SIGTERM):
            return run(arguments)
    except (RunFailed, ServerFailed) as error:
        print(f"stampede bench: {error}", file=sys.stderr)
        return EXIT_FAILED
    except OSError as error:
        if error.filename is None or "out" not in arguments:
            raise
        text = f"stampede bench: {error.filename}: {error.strerror}; name another folder with --out"
        print(escaped(text), file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print("\nstampede bench: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _paper(arguments: argparse.Namespace) -> int:
    folder: Path = arguments.out
    effort = Effort(items_max=arguments.items_max, runs=arguments.runs, frames=arguments.frames)
    folder.mkdir(parents=True, exist_ok=True)
    figures = []
    for name in arguments.figure or FIGURES:
        title, measure = FIGURES[name]
        announce(f"{title[0].upper()}{title[1:]}", arguments.output)
        chart = folder / f"{name}.png"
        table = measure(effort, chart)
        show(table, arguments.output)
        figures.append({"figure": name, "title": title, "chart": str(chart), **table.values()})
    if arguments.output != "table":
        print_rows(figures, arguments.output, none="")
    return 0


def _matching(arguments: argparse.Namespace) -> int:
    table = compare(arguments.seconds, arguments.seed)
    finish(table.values(), table.render(), arguments.output)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = TerminalParser(prog="stampede bench", description="Benchmarks of Stampede RT and of similar software.")
    kinds = parser.add_subparsers(dest="kind", metavar="NAME")
    _add_paper(kinds)
    _add_limits(kinds)
    _add_peers(kinds)
    _add_growth(kinds)
    _add_capacity(kinds)
    text = "our match and the synchroniser of ROS message_filters compared, on the same recorded inputs"
    matching = kinds.add_parser("matching", help=text, description=text)
    matching.add_argument(
        "--seconds", type=_between(15, 3600), default=60, help="the length of each recording (default: 60)"
    )
    matching.add_argument("--seed", type=_between(0, 2**31), default=1, help="the seed of the recordings (default: 1)")
    matching.set_defaults(run=_matching)
    for one in kinds.choices.values():
        add_output(one)
    return parser


def _add_paper(kinds: Any) -> None:
    listing = "\n".join(f"  {name:<12}{title}" for name, (title, _) in FIGURES.items())
    paper = kinds.add_parser(
        "paper",
        description=f"The figures of the paper, measured on this machine:\n\n{listing}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        help="the figures of the paper",
    )
    paper.add_argument(
        "--figure", action="append", choices=FIGURES, metavar="NAME", help="only this figure; may be repeated"
    )
    paper.add_argument(
        "--items-max",
        type=_between(1000, ITEMS_MAX),
        default=ITEMS_MAX,
        metavar="N",
        help="the largest channel (default: 10,000,000, which takes 4 GiB and some minutes)",
    )
    paper.add_argument(
        "--runs", type=_between(1, RUNS_MAX), default=5, metavar="N", help="the runs for each figure (default: 5)"
    )
    paper.add_argument(
        "--frames",
        type=_between(FRAMES_MIN, FRAMES_MAX),
        default=contention.PAPER_FRAMES,
        metavar="N",
        help=f"the frames of each run of contention (default: {contention.PAPER_FRAMES}, as in the paper: 77 s)",
    )
    paper.add_argument(
        "--out", type=Path, default=Path("out/bench"), metavar="DIR", help="the folder for charts (default: out/bench)"
    )
    paper.set_defaults(run=_paper)


def _add_limits(kinds: Any) -> None:
    text = "the figures of bare grpcio, raw sockets and a copy in memory on this machine"
    limits = kinds.add_parser("limits", help=text, description=f"Measure {text}.")
    _add_effort(limits, Path("out/bench"))
    limits.set_defaults(run=measure_limits)


def _add_peers(kinds: Any) -> None:
    text = (
        "the same workload on Redis streams, NATS, JetStream and Zenoh, each with its real server, compared with ours"
    )
    peers = kinds.add_parser("peers", help=text, description=f"Measure {text}.")
    peers.add_argument(
        "--system",
        action="append",
        choices=SYSTEMS,
        metavar="NAME",
        help=f"only this system; may be repeated; {', '.join(SYSTEMS)}",
    )
    peers.add_argument(
        "--readers",
        action="append",
        type=_between(1, READERS_MAX),
        metavar="N",
        help=f"the number of readers of frames; may be repeated (default: {', '.join(map(str, READERS))})",
    )
    _add_effort(peers, Path("out/bench"))
    peers.set_defaults(run=measure_peers)


def _add_growth(kinds: Any) -> None:
    text = "the cost of a put and a get as channels, items, readers, groups and payloads grow"
    growth = kinds.add_parser("growth", help=text, description=f"Measure {text}.")
    growth.add_argument(
        "--of", action="append", choices=DIMENSIONS, metavar="NAME",
        help=f"measure only the growth of this; may be repeated; {', '.join(DIMENSIONS)}",
    )  # fmt: skip
    most = {
        "channels": (CHANNELS_MAX, 100_000, "the most channels of a host"),
        "items": (ITEMS_MAX, ITEMS_MAX, "the most items in a channel; 10,000,000 take 4 GiB and some minutes"),
        "readers": (SUBSCRIPTIONS_MAX, 1000, "the most readers of a channel"),
        "groups": (GROUPS_MAX, 500, "the most groups of a channel"),
    }
    growth.add_argument(
        "--operations", type=_between(1, 1_000_000), default=2000, metavar="N",
        help="the puts and the gets of each run (default: 2,000; fewer of large payloads, and with groups)",
    )  # fmt: skip
    for name, (bound, default, what) in most.items():
        growth.add_argument(
            f"--{name}-max",
            type=_between(1, bound),
            default=default,
            metavar="N",
            help=f"{what} (default: {default:,})",
        )
    growth.add_argument(
        "--runs", type=_between(1, RUNS_MAX), default=5, metavar="N", help="the runs of each figure (default: 5)"
    )
    growth.add_argument(
        "--out", type=Path, default=Path("out/bench"), metavar="DIR",
        help="the folder for the report (default: out/bench)",
    )  # fmt: skip
    growth.set_defaults(run=measure_growth)


def _add_capacity(kinds: Any) -> None:
    text = "rates, latencies and memory of one host, to choose the size of a cluster"
    capacity = kinds.add_parser("capacity", help=text, description=f"Measure {text}; docs/capacity.md explains them.")
    names = [MEMORY, *(workload.name for workload in capacity_workloads())]
    capacity.add_argument(
        "--work", action="append", choices=names, metavar="NAME",
        help=f"only this; may be repeated; {', '.join(names)}",
    )  # fmt: skip
    capacity.add_argument(
        "--items", type=_between(20, 1_000_000), default=20_000, metavar="N",
        help="the items that each run of memory puts one by one; it makes so many other things that they take similar "
        "memory (default: 20,000)",
    )  # fmt: skip
    _add_times(capacity, Path("out/bench"), rounds=3)
    capacity.set_defaults(run=measure_capacity)


def _add_effort(parser: argparse.ArgumentParser, folder: Path) -> None:
    names = [workload.name for workload in workloads()]
    parts = [name.split("-") for name in names]
    kinds = ["-".join(part[:count]) for part in parts for count in range(1, len(part))]
    parser.add_argument(
        "--work",
        action="append",
        choices=dict.fromkeys([*kinds, *names]),
        metavar="NAME",
        help=f"only this workload, or all workloads of this kind; may be repeated; {', '.join(names)}",
    )
    _add_times(parser, folder, rounds=5)


def _add_times(parser: argparse.ArgumentParser, folder: Path, *, rounds: int) -> None:
    parser.add_argument(
        "--seconds", type=_seconds, default=5.0, metavar="S", help="the time of each run in steady state (default: 5)"
    )
    parser.add_argument(
        "--rounds", type=_between(1, RUNS_MAX), default=rounds, metavar="N",
        help=f"the runs of each workload (default: {rounds})",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=folder, metavar="DIR", help=f"the folder for the report (default: {folder})"
    )


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not SECONDS_MIN <= seconds <= SECONDS_MAX:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seconds from {SECONDS_MIN:g} to {SECONDS_MAX:g}")
    return seconds


def _between(least: int, most: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        if not text.isdecimal() or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {least} to {most}")
        return int(text)

    return number
