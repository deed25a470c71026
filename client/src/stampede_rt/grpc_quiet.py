"""Imports gRPC with settings that do not disturb the program that uses this package.

Import this before any other module that imports gRPC.

With these settings gRPC logs errors only. By default it writes two lines about each refused handshake to standard
error, although the program gets the reason as an exception. With these settings gRPC also does nothing at a fork. By
default it starts its threads in the child. If the parent uses asyncio, these threads crash one child in three, even if
the child never uses gRPC (decision 0067). gRPC reads `$GRPC_VERBOSITY` and `$GRPC_ENABLE_FORK_SUPPORT` once, at its
import. If the user has set them, this module leaves them as they are.
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
        del os.environ[_name]  # child processes must not inherit this variable

__all__ = ["grpc"]
