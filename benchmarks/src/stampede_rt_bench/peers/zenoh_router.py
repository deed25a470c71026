"""A Zenoh router: `python -m stampede_rt_bench.peers.zenoh_router ADDRESS [ITEMS]`.

The Python package has the library of the router, but neither the program `zenohd` nor its storages. With ITEMS this
router keeps that many items, as Zenoh's own example `z_storage.py` does, and answers gets with them.
"""

from __future__ import annotations

import sys
import threading
from collections import deque
from typing import Any

from stampede_rt_bench.peers.zenoh_sessions import KEY, open_session


class ZenohStorage:
    """Keeps the last items in the order in which they came."""

    def __init__(self, items_max: int) -> None:
        self._samples: deque[Any] = deque(maxlen=items_max)

    def keep(self, sample: Any) -> None:
        """Keep an item. Drops the oldest item if there are too many."""
        self._samples.append(sample)

    def answer(self, query: Any) -> None:
        """Answer a get: with the parameter `newest` the newest item, otherwise the `items` oldest items."""
        items = int(query.parameters.get("items", "1"))
        held = len(self._samples)
        if query.parameters.get("newest") is not None:
            chosen = [self._samples[-1]] if held else []
        else:
            chosen = [self._samples[place] for place in range(min(items, held))]
        for sample in chosen:
            query.reply(KEY, sample.payload, timestamp=sample.timestamp)


def main() -> None:
    """Route until this process is killed."""
    address, *items = sys.argv[1:]
    session = open_session("router", address, listens=True)
    if items:
        storage = ZenohStorage(int(items[0]))
        kept = [session.declare_subscriber(KEY, storage.keep), session.declare_queryable(KEY, storage.answer)]
        assert all(kept)
    threading.Event().wait()


if __name__ == "__main__":
    main()
