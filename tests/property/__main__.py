"""Runs scenarios of paths by their seeds. This is much faster than hypothesis, but it does not shorten a failing
scenario.

`python -m tests.property core|awaited|blocking FIRST COUNT` stops at the first scenario in which a path and the oracle
disagree, and prints its seed and its steps.
"""

from __future__ import annotations

import logging
import random
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from tests.property.paths.core_surface import core_surface
from tests.property.paths.path_and_oracle import SteeredHost
from tests.property.paths.steered_rings import steered_rings
from tests.property.paths.steps import play
from tests.property.paths.surfaces import Surface, awaited_surface, blocking_surface
from tests.support.channel_host.loopback_host import loopback_host

SCENARIOS_PER_LINE = 1000


@contextmanager
def path_called(name: str) -> Iterator[tuple[Surface, SteeredHost]]:
    """Yield one of the paths."""
    if name == "core":
        with core_surface(items_per_block=2) as path:
            yield path
        return
    open_surface = {"awaited": awaited_surface, "blocking": blocking_surface}[name]
    with loopback_host() as host, steered_rings(host), open_surface(host) as surface:
        yield surface, host


def numbers_of(seed: int) -> list[int]:
    """The random numbers of the scenario with this seed."""
    rng = random.Random(seed)
    return [rng.getrandbits(96) for _ in range(rng.randint(20, 40))]


def main(name: str, first: int, count: int) -> None:
    """Run `count` scenarios, from the seed `first` on."""
    # the client warns of a lost consumer place whenever a scenario deletes its channel
    logging.disable(logging.WARNING)
    began_s = time.monotonic()
    with path_called(name) as (surface, host):
        for played, seed in enumerate(range(first, first + count), 1):
            steps: list[str] = []
            try:
                play(surface, host, numbers_of(seed), steps.append)
            except BaseException:
                print(f"{name}, seed {seed}: {' '.join(steps)}", file=sys.stderr)
                traceback.print_exc()  # before the calls under way end
                raise
            if played % SCENARIOS_PER_LINE == 0 or played == count:
                print(f"{name}: {played} scenarios in {time.monotonic() - began_s:.0f} s", flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
