"""Random inputs for one target, the same for the same seed, without coverage guidance."""

from __future__ import annotations

import random
import time
import traceback

from tests.robustness.fuzz.drawing import drawn_bytes
from tests.robustness.fuzz.parsers.catalogue import BY_NAME

FOUND_MAX = 5
INPUT_SECONDS_MAX = 5.0  # CPU time for one input: 10,000 times that of the slowest input


def run_unguided(name: str, *, inputs: int, seconds: float, seed: int) -> bool:
    """Returns whether nothing was found. Prints the findings and the number of inputs."""
    target, random_source = BY_NAME[name], random.Random(f"{seed}/{name}")
    began, taken, done, found, slowest = time.monotonic(), 0, 0, 0, 0.0
    while done < inputs and found < FOUND_MAX and time.monotonic() - began < seconds:
        done += 1
        data, since = drawn_bytes(random_source), time.process_time()
        try:
            taken += target(data)
        except Exception:  # noqa: BLE001 - every such error is a finding
            print(f"FOUND by {name}: {data.hex()}\n{traceback.format_exc()}")
            found += 1
        slowest = max(slowest, time.process_time() - since)
    if slowest > INPUT_SECONDS_MAX:
        print(f"FOUND by {name}: one input took {slowest:.1f} s")
        found += 1
    spent = time.monotonic() - began
    print(f"{name}: {done:,} inputs, {taken:,} taken, {done / max(spent, 1e-9):,.0f}/s, slowest {slowest * 1e3:.0f} ms")
    return not found
