"""Imports gRPC with settings that leave its users' programs alone.

Import this before any other module that imports gRPC.

gRPC logs errors only. Otherwise it writes two lines about each refused handshake to standard error, although the
program gets the reason as an exception. gRPC does nothing at a fork. Otherwise it starts its threads in the child,
where they crash one child in three of a parent that uses asyncio, even if the child never uses gRPC (decision 0067).
gRPC reads `$GRPC_VERBOSITY` and `$GRPC_ENABLE_FORK_SUPPORT` once, at its import. If the user has set them, they decide.
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
        del os.environ[_name]  # do not pass it on to child processes

__all__ = ["grpc"]
