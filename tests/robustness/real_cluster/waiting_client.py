"""A client with three waiting calls: `python -m tests.robustness.real_cluster.waiting_client FRONTEND CHANNEL
TRANSPORT`.

It subscribes to CHANNEL, waits for an item of the far future, and puts into CHANNEL/full, which has no room. It ends
when all three calls have ended.
"""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import stampede_rt as st

FAR_NANOS = 10**13


def main(frontend: str, name: str, transport: str) -> None:
    """Wait until the three calls have ended, with any outcome."""
    with st.connect(frontend, transport=transport) as rt, ThreadPoolExecutor(3) as threads:
        channel, full = rt.channel(name, create=False), rt.channel(f"{name}/full", create=False)
        threads.submit(list, channel.subscribe())
        threads.submit(channel.newest, st.now() + FAR_NANOS, timeout=None)
        threads.submit(full.put, b"waits", timeout=None)


if __name__ == "__main__":
    main(*sys.argv[1:])
