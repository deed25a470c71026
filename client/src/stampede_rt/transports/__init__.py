"""Sends requests over gRPC and sockets, and reads from shared memory and multicast.

Each module `..._async` has a counterpart `..._sync` with the same names.
"""

from stampede_rt import grpc_quiet as _grpc_quiet  # noqa: F401  # before anything here imports gRPC
