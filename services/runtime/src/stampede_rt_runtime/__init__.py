"""Stampede RT: the code that all services share."""

import stampede_rt.grpc_quiet  # noqa: F401  # before anything here imports gRPC
