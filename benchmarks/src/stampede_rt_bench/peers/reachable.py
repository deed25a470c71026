"""Whether a server of this machine takes connections."""

from __future__ import annotations

import socket

TRY_SECONDS = 0.5


def is_listening(port: int) -> bool:
    """Whether something on the loopback accepts one now."""
    try:
        with socket.create_connection(("127.0.0.1", port), TRY_SECONDS):
            return True
    except OSError:
        return False
