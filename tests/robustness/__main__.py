"""The robustness suite: `python -m tests.robustness --report out/robustness.md` (also `make robustness`).

Needs root and iproute2. To repeat a simulated seed that failed, run
`python -m tests.robustness.directory.simulate --first SEED --seeds 1`. To inject the real faults in the same order and
with the same random choices again, give the same --seed.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Coroutine
from pathlib import Path
from typing import Any

from stampede_rt_local.namespaces import unavailable_because
from tests.robustness.campaign import (
    COPY_FAULTS,
    HOST_FAULTS,
    HOSTILE_FAULTS,
    HOSTS,
    LAGGING,
    LINK_CONDITIONS,
    RARELY_COMPACTED_FAULTS,
    REPLICATED,
    SECURED_FAULTS,
    Findings,
    in_rounds,
    run_campaign,
    run_link_conditions,
)
from tests.robustness.directory.simulate import run_seeds
from tests.robustness.report import TITLE, Run, broken_promises, write_report

# How the minutes are divided.
SECURED_SHARE, OPEN_SHARE, HOSTS_SHARE, COPIES_SHARE, LAGGING_SHARE = 0.2, 0.15, 0.15, 0.15, 0.15
HOSTILE_SHARE, BAD_LINKS_SHARE = 0.1, 0.1
NAMES = ("secured", "open", "hosts", "copies", "lagging", "hostile", "bad_links")


def arguments() -> argparse.Namespace:
    """Return the parsed command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.robustness", description=__doc__)
    where = "file for the report; text above an earlier report in this file stays, as in docs/robustness.md"
    parser.add_argument("--report", type=Path, default=Path("out/robustness.md"), help=where)
    parser.add_argument("--minutes", type=float, default=14.0, help="approximate time for the faults in real processes")
    parser.add_argument("--seeds", type=int, default=200, help="the number of seeds that the simulated directory runs")
    parser.add_argument(
        "--seed", type=int, default=1, help="random seed for the order and the choices of the real faults"
    )
    parser.add_argument(
        "--only", choices=NAMES, nargs="+", default=NAMES, help="run only these campaigns (default: all)"
    )
    return parser.parse_args()


def campaigns(folder: Path, seconds: float, seed: int) -> dict[str, Callable[[], Coroutine[Any, Any, Findings]]]:
    """All campaigns, by name. Their states are in `folder`."""
    return {
        "secured": lambda: run_campaign(
            folder / "secured",
            "Directory with certificates",
            in_rounds(SECURED_FAULTS, seed, seconds * SECURED_SHARE),
            seed=seed,
            secured=True,
        ),
        "open": lambda: run_campaign(
            folder / "open",
            "Directory without certificates",
            in_rounds(RARELY_COMPACTED_FAULTS, seed + 1, seconds * OPEN_SHARE),
            seed=seed + 1,
            secured=False,
            compacts_early=False,
        ),
        "hosts": lambda: run_campaign(
            folder / "hosts",
            "Channel hosts and front-end, with certificates",
            in_rounds(HOST_FAULTS, seed + 2, seconds * HOSTS_SHARE),
            seed=seed + 2,
            secured=True,
            hosts=HOSTS,
        ),
        "copies": lambda: run_campaign(
            folder / "copies",
            "Copies: channels with a replica",
            in_rounds(COPY_FAULTS, seed + 5, seconds * COPIES_SHARE),
            seed=seed + 5,
            secured=False,
            hosts=HOSTS,
            policy=REPLICATED,
        ),
        "lagging": lambda: run_campaign(
            folder / "lagging",
            "Copies: channels with a replica for which no put waits",
            in_rounds(COPY_FAULTS, seed + 6, seconds * LAGGING_SHARE),
            seed=seed + 6,
            secured=False,
            hosts=HOSTS,
            policy=LAGGING,
        ),
        "hostile": lambda: run_campaign(
            folder / "hostile",
            "Hostile clients beside good ones",
            in_rounds(HOSTILE_FAULTS, seed + 4, seconds * HOSTILE_SHARE, all_once=True),
            seed=seed + 4,
            secured=False,
            hosts=1,
            compacts_early=False,
        ),
        "bad_links": lambda: run_link_conditions(
            folder / "bad_links",
            "Directory behind bad links",
            seed=seed + 3,
            each_s=max(10.0, seconds * BAD_LINKS_SHARE / len(LINK_CONDITIONS)),
        ),
    }


async def real_faults(minutes: float, seed: int, names: Collection[str] = NAMES) -> list[Findings]:
    """Run the campaigns of these names, one after the other."""
    with tempfile.TemporaryDirectory(prefix="robustness-") as folder:
        known = campaigns(Path(folder), minutes * 60, seed)
        return [await known[name]() for name in NAMES if name in names]


def main() -> int:
    """Run everything and write the report; return 1 if a promise was broken, 2 if this machine cannot run the suite."""
    wanted = arguments()
    if why := unavailable_because():
        print(f"cannot run: {why}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by a signal"))  # cleans up, as Ctrl-C does
    began, load = time.monotonic(), os.getloadavg()[0]
    simulated = run_seeds(0, wanted.seeds)
    findings = asyncio.run(real_faults(wanted.minutes, wanted.seed, wanted.only))
    command = f"python -m tests.robustness --minutes {wanted.minutes:g} --seeds {wanted.seeds} --seed {wanted.seed}"
    command += "" if wanted.only == NAMES else f" --only {' '.join(wanted.only)}"
    took = time.monotonic() - began
    run = Run(command, _revision(), took, (load, os.getloadavg()[0]), findings, simulated)
    page = write_report(run)
    write_page(wanted.report, page)
    print(page)
    broken = broken_promises(run)
    for one in broken:
        print(f"broken: {one}", file=sys.stderr)
    return 1 if broken else 0


def write_page(file: Path, page: str) -> None:
    """Write the report into the file. It replaces the earlier report there; the text above that report stays."""
    file.parent.mkdir(parents=True, exist_ok=True)
    above, title, _ = file.read_text().partition(TITLE) if file.exists() else ("", "", "")
    file.write_text((above if title else "") + page)


def _revision() -> str:
    found = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    return found.stdout.strip() or os.environ.get("ROBUSTNESS_REVISION", "an unknown revision")


if __name__ == "__main__":
    sys.exit(main())
