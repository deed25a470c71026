"""Measures how long one piece of long work stops a host's event loop: `python -m tests.benchmarks.longest_pause`.

There is one host. The benchmark fills its channels in the host's process. A separate process makes the calls of
clients. The benchmark does all other work as the host's shell does it. Meanwhile the loop turns as fast as possible. A
pause is the CPU time of its thread from one turn to the next, so other work of the machine does not count. The table
has the longest pause, and the CPU time of the whole work. A pause of the garbage collector counts, too.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
from collections.abc import Awaitable, Callable, Sequence

from stampede_rt_bench.tables import Table
from stampede_rt_runtime.garbage import GarbageCollection
from tests.benchmarks.longest_pause.client import ask
from tests.benchmarks.longest_pause.groups import group_readers, late_items
from tests.benchmarks.longest_pause.leases import elsewhere, fence, registration, touched
from tests.benchmarks.longest_pause.queues import batches
from tests.benchmarks.longest_pause.reads import given_up_get, large_get, listing, page, subscription
from tests.benchmarks.longest_pause.retention import (
    backwards,
    consumption,
    deletion,
    first_consumers,
    replacement,
    smaller_limit,
)
from tests.benchmarks.longest_pause.sizes import (
    BLOCKED_GETS,
    BUCKET_ITEMS,
    CHANNELS,
    GROUP_READERS,
    HELD_CHANNELS,
    ITEMS,
    LATE_ITEMS,
    QUEUED_ITEMS,
    REPLACED_ITEMS,
    SUBSCRIBERS,
    WATCHES,
)
from tests.benchmarks.longest_pause.waking import left_gets, reach, release, subscribers
from tests.benchmarks.longest_pause.watch import Watch, Work
from tests.benchmarks.longest_pause.watches import watch, watches
from tests.support.channel_host.rig import Rig, running_host

Case = Callable[[Rig, int], Awaitable[tuple[str, Work]]]

CASES: dict[str, tuple[Case, int]] = {
    "get": (large_get, ITEMS),
    "given-up": (given_up_get, ITEMS),
    "subscribe": (subscription, ITEMS),
    "configure": (smaller_limit, ITEMS),
    "replacement": (replacement, REPLACED_ITEMS),
    "late": (late_items, LATE_ITEMS),
    "page": (page, BUCKET_ITEMS),
    "reach": (reach, BUCKET_ITEMS),
    "consumption": (consumption, ITEMS),
    "first-consumers": (first_consumers, ITEMS),
    "backwards": (backwards, 2 * CHANNELS * 10),
    "delete": (deletion, ITEMS),
    "release": (release, BLOCKED_GETS),
    "left-gets": (left_gets, BLOCKED_GETS),
    "list": (listing, CHANNELS),
    "batches": (batches, QUEUED_ITEMS),
    "subscribers": (subscribers, SUBSCRIBERS),
    "watches": (watches, WATCHES),
    "group-readers": (group_readers, GROUP_READERS),
    "fence": (fence, HELD_CHANNELS),
    "registration": (registration, HELD_CHANNELS),
    "elsewhere": (elsewhere, HELD_CHANNELS),
    "touched": (touched, HELD_CHANNELS),
}


async def measure(names: Sequence[str], share: float) -> None:
    """Measure each case at a host of its own."""
    table = Table(("longest pause, ms", "all, ms", "work"))
    for name in names:
        case, items = CASES[name]
        async with GarbageCollection(), running_host(memory_bytes_max=2**40) as rig:
            text, work = await case(rig, int(items * share))
            watch = Watch()
            all_ms = await watch.measure(work)
            table.rows.append((f"{watch.longest_ms:,.1f}", f"{all_ms:,.0f}", text))
            print(json.dumps({"case": name, "longest_ms": watch.longest_ms, "all_ms": all_ms}), file=sys.stderr)
    table.print()


def main() -> None:
    """Measure and print; with --client be the client."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", help=f"of {', '.join(CASES)}; none: all")
    parser.add_argument("--share", type=float, default=1.0, help="the measured share of the items")
    parser.add_argument("--client", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.client:
        target, verb, count, _ = options.client
        if verb == "watch":
            asyncio.run(watch(target, int(count)))
        else:
            ask(*options.client)
    else:
        asyncio.run(measure(options.cases or [*CASES], options.share))


if __name__ == "__main__":
    main()
