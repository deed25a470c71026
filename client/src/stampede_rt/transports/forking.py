"""Detects forked children. If a process has used gRPC, its forked child cannot use gRPC.

gRPC's threads and sockets do not survive a fork. Calls on inherited connections hang for ever, and new connections
sometimes hang or abort the child. With this module both raise ForkedProcess instead. Decision 0067 has the
measurements.
"""

from __future__ import annotations

import os
import socket
from weakref import WeakSet

from stampede_rt.errors import ForkedProcess

_WAY_OUT = (
    'start it with multiprocessing.get_context("spawn") (DataLoader: multiprocessing_context="spawn"), and pass it '
    "channels, groups and queues as they are; or connect only after the fork"
)

_forks = 0  # forks between the process that loaded this module and this one
_open: WeakSet[object] = WeakSet()  # the owners of gRPC connections in this process
_opened_ever = False  # whether this process, or a process that it was forked from, has opened a gRPC connection
_inherited: list[object] = []  # referenced for ever, because the deletion of a parent's gRPC object hangs, too
_sockets: WeakSet[socket.socket] = WeakSet()  # a child that kept one open would keep the connection open
_refused = False  # whether this process is a forked child that cannot use gRPC


def forks() -> int:
    """Return the number of forks between the process that loaded this module and this process."""
    return _forks


def opened(connections: object) -> None:
    """Note that the object `connections` opens gRPC connections.

    Raises ForkedProcess in a child that cannot use gRPC.
    """
    global _opened_ever
    if _refused:
        raise ForkedProcess(
            "this process was forked from a process that was already connected, and gRPC does not work in the child: "
            f"{_WAY_OUT}"
        )
    _opened_ever = True
    _open.add(connections)


def closed(connections: object) -> None:
    """Note that the object `connections` has closed all its gRPC connections."""
    _open.discard(connections)


def keep_out_of_children(connected: socket.socket) -> None:
    """Close the socket in each forked child."""
    _sockets.add(connected)


def check(made_at: int) -> None:
    """Raise ForkedProcess if another process made the connection. `made_at`: the value of `forks` when it was made."""
    if made_at != _forks:
        raise ForkedProcess(
            f"this connection was made before its process was forked, and does not work in the child: {_WAY_OUT}"
        )


def _in_child() -> None:
    global _forks, _refused
    _forks += 1
    _refused = _opened_ever
    _inherited.extend(_open)
    _open.clear()
    for one in tuple(_sockets):
        one.close()
    _sockets.clear()


os.register_at_fork(after_in_child=_in_child)
