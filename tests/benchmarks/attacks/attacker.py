"""The attacker's process: reads the attacked cluster from its standard input, and attacks until the input is closed.

It prints a line once the attack is under way. With the further argument "apart" it takes only the processor time that
no other program wants, as if it ran on another machine.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sys

from stampede_rt_runtime import open_files
from tests.benchmarks.attacks.attacked_cluster import AttackedCluster
from tests.benchmarks.attacks.catalogue import CASES

UNDER_WAY = "under way"


async def attack(name: str, attacked: AttackedCluster) -> None:
    """Run the attack until standard input ends."""
    work = asyncio.create_task(_attack(name, attacked))
    ended = asyncio.create_task(asyncio.to_thread(sys.stdin.read))
    await asyncio.wait({work, ended}, return_when=asyncio.FIRST_COMPLETED)
    if work.done():
        work.result()
    work.cancel()
    await asyncio.wait({work}, timeout=1.0)


async def _attack(name: str, attacked: AttackedCluster) -> None:
    with contextlib.suppress(asyncio.CancelledError):
        await CASES[name].attack(attacked, lambda: print(UNDER_WAY, flush=True))


def main() -> None:
    """Run the attacker with the name of the first argument. With another argument it takes only idle processor time."""
    if len(sys.argv) > 2:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    open_files.raise_limit()
    asyncio.run(attack(sys.argv[1], AttackedCluster.from_line(sys.stdin.readline())))


if __name__ == "__main__":
    main()
