"""Checks whether a server on this machine accepts connections."""

from __future__ import annotations

import socket

TRY_SECONDS = 0.5


def is_listening(port: int) -> bool:
    """Whether a server accepts connections at `port` of the loopback now."""
    try:
        with socket.create_connection(("127.0.0.1", port), TRY_SECONDS):
            return True
    except OSError:
        return False
