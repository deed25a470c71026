"""How requests travel. Modules named `_async` and `_sync` offer the same names."""

from stampede_rt import grpc_quiet as _grpc_quiet  # noqa: F401  # before anything here imports gRPC
