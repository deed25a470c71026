"""`stampede demo NAME`: demonstrations on real media, through a real cluster."""

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
from stampede_rt_demos.failures import DemoFailed
from stampede_rt_demos.staging.film import require_libraries

EXIT_FAILED = 1
EXIT_INTERRUPTED = 130
SECONDS_DEFAULT = 20

DEMOS = {
    "tv-watcher": "a film's video, sound and captions, analysed and watched in step (paper, section 5)",
    "rover": "cameras in the rover's own process, a planner that joins, a killed host (paper, section 5: LAGR)",
    "stereo": "two cameras paired by time, depth from every pair, a planner and a mapper (paper, section 5: LAGR)",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a demo, or list all demos.

    Returns the exit status: 0, 1 after a failure (printed in a sentence), 130 after Ctrl-C.
    """
    arguments = _parser().parse_args(sys.argv[1:] if argv is None else argv)
    if arguments.demo is None:
        rows = [{"demo": name, "about": about} for name, about in DEMOS.items()]
        print(_listing()) if arguments.output == "table" else print_rows(rows, arguments.output, none="")
        return 0
    try:
        with unwinding(signal.SIGINT, signal.SIGTERM):
            run: Callable[[argparse.Namespace], int] = arguments.run
            return run(arguments)
    except DemoFailed as failure:
        print(f"stampede demo {arguments.demo}: {escaped(str(failure))}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print(f"\nstampede demo {arguments.demo}: interrupted; nothing is left running", file=sys.stderr)
        return EXIT_INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = TerminalParser(prog="stampede demo", description=_listing(), formatter_class=_Formatter)
    add_output(parser)
    demos = parser.add_subparsers(dest="demo", metavar="NAME")
    for name, run in (("tv-watcher", _tv_watcher), ("stereo", _stereo), ("rover", _rover)):
        demo = demos.add_parser(name, description=DEMOS[name], formatter_class=_Formatter)
        demo.add_argument("--seconds", type=_seconds, default=SECONDS_DEFAULT, help="length of the run (default: 20)")
        demo.add_argument("--picture", type=Path, metavar="PATH", help="the file for a picture of the run (PNG)")
        if name != "rover":
            demo.add_argument(
                "--certificates",
                action="store_true",
                help="encrypt all traffic; the roles have certificates, not tokens",
            )
        add_output(demo, default=argparse.SUPPRESS)  # so that the default of the outer parser counts
        demo.set_defaults(run=run)
    return parser


def _tv_watcher(arguments: argparse.Namespace) -> int:
    """Run the TV watcher. The imports are here, because a list of demos must work without these libraries."""
    require_libraries()
    from stampede_rt_demos.tv_watcher.app import run

    return run(**_common(arguments), certificates=arguments.certificates)


def _stereo(arguments: argparse.Namespace) -> int:
    require_libraries()
    from stampede_rt_demos.stereo.app import run

    return run(**_common(arguments), certificates=arguments.certificates)


def _rover(arguments: argparse.Namespace) -> int:
    require_libraries()
    from stampede_rt_demos.rover.app import run

    return run(**_common(arguments))


def _common(arguments: argparse.Namespace) -> dict[str, Any]:
    return {"seconds": arguments.seconds, "picture": arguments.picture, "form": arguments.output}


def _seconds(text: str) -> int:
    """Return whole seconds in the range that the roles of the TV watcher accept."""
    if not text.isdecimal() or not 2 <= int(text) <= 600:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of seconds from 2 to 600")
    return int(text)


def _listing() -> str:
    lines = [f"  {name:<12}{what}" for name, what in DEMOS.items()]
    return "\n".join(["Demonstrations on real media, through a real cluster on this machine:", "", *lines])


class _Formatter(argparse.RawDescriptionHelpFormatter):
    pass
