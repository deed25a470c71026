"""Recognises processes of the same machine and user, which can use Unix sockets with each other. Linux only."""

from __future__ import annotations

import functools
import os
import socket
import struct
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
SEND_BUFFER_BYTES = 2**18  # the system doubles it
_PEER_CREDENTIALS = struct.Struct("3i")  # pid, uid and gid, see SO_PEERCRED in unix(7)


@functools.cache
def _boot_id() -> str:
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""


def machine_id() -> str:
    """Return the machine's boot id, which all its processes and containers share; empty if there is none."""
    return _boot_id()[:64]


def this_machine() -> str:
    """Return the machine's boot id and the process's user id, "BOOT_ID:UID"; empty on a system without boot ids."""
    return f"{_boot_id()}:{os.geteuid()}" if _boot_id() and hasattr(socket, "SO_PEERCRED") else ""


def is_of_this_user(connected: socket.socket) -> bool:
    """Whether the process at the other end of a Unix socket has the user id of this process."""
    raw = connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
    return bool(_PEER_CREDENTIALS.unpack(raw)[1] == os.geteuid())


def enlarge_send_buffer(connected: socket.socket) -> None:
    """Let the system take a message of 300 KB from this Unix socket in one call. By default it takes 214 KiB."""
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
