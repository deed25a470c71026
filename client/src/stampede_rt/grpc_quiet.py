"""Imports gRPC so that it logs errors only; imported before anything else here that imports gRPC.

Otherwise gRPC writes two lines about each refused handshake to the standard error of every program that uses this
package, beside the sentence that the program gets as an exception. `$GRPC_VERBOSITY`, which it reads once, when it is
imported, still decides if it is set.
"""

from __future__ import annotations

import os

_VARIABLE = "GRPC_VERBOSITY"

if _VARIABLE in os.environ:
    import grpc
else:
    os.environ[_VARIABLE] = "ERROR"
    try:
        import grpc
    finally:
        del os.environ[_VARIABLE]  # child processes are none of our business

__all__ = ["grpc"]
