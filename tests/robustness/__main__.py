"""The robustness suite: `python -m tests.robustness --report out/robustness.md` (also `make robustness`).

Needs root and iproute2 for the real processes; `--seeds` alone runs without. A failure of a seed is replayed with
`python -m tests.robustness.directory.simulate --first SEED --seeds 1`.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.robustness.campaign import EVERY_FAULT, Findings, run_campaign, run_weathers
from tests.robustness.directory.simulate import run_seeds
from tests.robustness.network import unavailable_because
from tests.robustness.report import limits_broken, write_report

# So many of the time goes to the network's weather; the rest to the faults, one after the other.
WEATHER_SHARE = 0.2
ROUND_SECONDS = 140.0


def arguments() -> argparse.Namespace:
    """What the caller wants."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--report", type=Path, default=Path("out/robustness.md"), help="where the page goes")
    parser.add_argument("--minutes", type=float, default=20.0, help="about so long for the real processes")
    parser.add_argument("--seeds", type=int, default=400, help="of the simulated directory")
    parser.add_argument("--seed", type=int, default=1, help="of the order of the faults")
    return parser.parse_args()


def planned_faults(minutes: float, seed: int) -> list[str]:
    """Every fault in each round, in an order of its own."""
    dice = random.Random(seed)
    rounds = max(1, round(minutes * 60 * (1 - WEATHER_SHARE) / ROUND_SECONDS))
    return [name for _ in range(rounds) for name in dice.sample(sorted(EVERY_FAULT), len(EVERY_FAULT))]


async def real_faults(minutes: float, seed: int) -> list[Findings]:
    """Both campaigns. Raises what they find."""
    with tempfile.TemporaryDirectory(prefix="robustness-") as folder:
        faults = planned_faults(minutes, seed)
        found = [await run_campaign(Path(folder) / "faults", faults, seed=seed)]
        each_s = max(10.0, minutes * 60 * WEATHER_SHARE / 5)
        found.append(await run_weathers(Path(folder) / "weather", seed=seed, each_s=each_s))
    return found


def main() -> int:
    """Run everything and write the page; returns 1 if a promise was broken, 2 if the machine does not allow it."""
    wanted = arguments()
    if why := unavailable_because():
        print(f"cannot run: {why}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended by a signal"))  # cleans up, as Ctrl-C does
    load = f"load average at the start {os.getloadavg()[0]:.1f}"
    simulated = run_seeds(0, wanted.seeds)
    real = asyncio.run(real_faults(wanted.minutes, wanted.seed))
    command = f"python -m tests.robustness --minutes {wanted.minutes:g} --seeds {wanted.seeds} --seed {wanted.seed}"
    load += f", at the end {os.getloadavg()[0]:.1f}"
    page = write_report(command, _state(), load, real, simulated)
    wanted.report.parent.mkdir(parents=True, exist_ok=True)
    wanted.report.write_text(page)
    print(page)
    broken = limits_broken(outcome for findings in real for outcome in findings.outcomes)
    for one in broken:
        print(f"limit broken: {one}", file=sys.stderr)
    return 1 if broken or simulated.failed else 0


def _state() -> str:
    found = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    revision = found.stdout.strip() or os.environ.get("ROBUSTNESS_REVISION", "an unknown revision")
    return f"{revision}, {time.strftime('%Y-%m-%d %H:%M UTC', time.gmtime())}"


if __name__ == "__main__":
    sys.exit(main())
