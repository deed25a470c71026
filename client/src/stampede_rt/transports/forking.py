"""What a forked child may do with gRPC: nothing with what its parent had open, and nothing at all if that was much.

gRPC's threads and sockets do not survive a fork: calls on inherited connections hang for ever. New connections hang or
abort the child now and then, if the parent had calls under way when it forked. So both are refused at once.
"""

from __future__ import annotations

import os
from weakref import WeakSet

from stampede_rt.errors import ForkedProcess
from stampede_rt.grpc_quiet import grpc

_SUPPORTED_SINCE = (1, 74)  # from here on gRPC puts itself in order in a child, unless it is told not to
_WAY_OUT = (
    'start the process with multiprocessing.get_context("spawn") (DataLoader: multiprocessing_context="spawn"), to '
    "which channels, groups and queues can be passed as they are"
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
            f"this process was forked while its parent had a connection open, and gRPC cannot be used in it: connect "
            f"only after the fork, close the parent's connections before it, or {_WAY_OUT}"
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
            f"this connection was made before its process was forked, and does not work in the child: connect() in the "
            f"child, before which the parent has none open, or {_WAY_OUT}"
        )


def _in_child() -> None:
    global _forks, _refused
    _forks += 1
    inherited = list(_open)
    _refused = _refused or bool(inherited) or (_opened_ever and not _grpc_puts_itself_in_order())
    _inherited.extend(inherited)
    _open.clear()


def _grpc_puts_itself_in_order() -> bool:
    told = os.environ.get("GRPC_ENABLE_FORK_SUPPORT", "").lower()
    version = tuple(int(part) for part in grpc.__version__.split(".")[:2])
    return told not in ("0", "f", "false", "n", "no") if told else version >= _SUPPORTED_SINCE


os.register_at_fork(after_in_child=_in_child)
