"""Configures and opens sessions of Zenoh. Multicast is off, so that two measurements on one network do not connect."""

from __future__ import annotations

import json
from typing import Any, Literal

KEY = "bench/items"
RETRY_MILLIS = 50
SHARED_MEMORY_BYTES = 64 << 20

Mode = Literal["client", "peer", "router"]


def open_session(mode: Mode, address: str, *, listens: bool, shared_memory: bool = False) -> Any:
    """Return a session that listens at the address or connects to it. It adds the time to each item that it puts."""
    import zenoh

    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "timestamping/enabled": True,
        "transport/shared_memory/enabled": shared_memory,
        ("listen" if listens else "connect") + "/endpoints": [address],
    }
    if not listens:
        settings["listen/endpoints"] = []
        settings["connect/timeout_ms"] = -1
        settings["connect/exit_on_failure"] = False
        settings["connect/retry"] = {"period_init_ms": RETRY_MILLIS, "period_max_ms": RETRY_MILLIS}
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)
