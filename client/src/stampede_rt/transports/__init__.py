"""How requests travel. Everything above works the same on each; `_async` and `_sync` names pair up."""

from stampede_rt import grpc_quiet as _grpc_quiet  # noqa: F401  # before anything here imports gRPC
