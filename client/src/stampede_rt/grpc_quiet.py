"""Imports gRPC so that it leaves its users' programs alone; imported before anything else here that imports gRPC.

It logs errors only: otherwise it writes two lines about each refused handshake to the standard error of every program
that uses this package, beside the sentence that the program gets as an exception. And it does nothing at a fork:
otherwise it starts its threads in the child, where they crash one child in three of a parent that uses asyncio, though
the child never uses gRPC (decision 0067). `$GRPC_VERBOSITY` and `$GRPC_ENABLE_FORK_SUPPORT`, which it reads once, when
it is imported, still decide if they are set.
"""

from __future__ import annotations

import os

_VARIABLES = {"GRPC_VERBOSITY": "ERROR", "GRPC_ENABLE_FORK_SUPPORT": "0"}
_unset = _VARIABLES.keys() - os.environ.keys()

try:
    os.environ.update({name: _VARIABLES[name] for name in _unset})
    import grpc
finally:
    for _name in _unset:
        del os.environ[_name]  # child processes are none of our business

__all__ = ["grpc"]
