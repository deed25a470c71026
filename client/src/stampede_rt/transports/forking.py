"""What a forked child may do with gRPC: nothing, if its parent has ever used it.

gRPC's threads and sockets do not survive a fork: calls on inherited connections hang for ever, and new connections hang
or abort the child now and then. Both are refused at once; decision 0067 has the measurements.
"""

from __future__ import annotations

import os
from weakref import WeakSet

from stampede_rt.errors import ForkedProcess

_WAY_OUT = (
    'start it with multiprocessing.get_context("spawn") (DataLoader: multiprocessing_context="spawn"), to which '
    "channels, groups and queues can be passed as they are, or connect nowhere before the fork"
)

_forks = 0  # how many lie between this process and the one that loaded this module
_open: WeakSet[object] = WeakSet()  # what has gRPC connections, in this process
_opened_ever = False
_inherited: list[object] = []  # held for good: letting go of a gRPC object of the parent hangs, too
_refused = False


def forks() -> int:
    """A number that is another one after each fork, in the child."""
    return _forks


def opened(connections: object) -> None:
    """These gRPC connections begin. Raises ForkedProcess where gRPC cannot be used any more."""
    global _opened_ever
    if _refused:
        raise ForkedProcess(
            f"this process was forked from one that had connected already, and gRPC cannot be used in it: {_WAY_OUT}"
        )
    _opened_ever = True
    _open.add(connections)


def closed(connections: object) -> None:
    """These have ended."""
    _open.discard(connections)


def check(made_at: int) -> None:
    """Raises ForkedProcess for a connection that was made in another process than this one; `made_at`: see `forks`."""
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


os.register_at_fork(after_in_child=_in_child)
