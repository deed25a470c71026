"""Server reflection: a server describes its services, so that tools such as grpcurl need no .proto files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import grpc

from stampede_rt_runtime.health import SERVICE as HEALTH


def noting_names(server: grpc.aio.Server) -> list[str]:
    """A list that gets the name of each service registered at `server` from now on.

    gRPC keeps these names to itself.
    """
    names = [HEALTH]
    register: Callable[[str, Any], None] = server.add_registered_method_handlers

    def noting(service: str, handlers: Any) -> None:
        names.append(service)
        register(service, handlers)

    setattr(server, "add_registered_method_handlers", noting)  # noqa: B010 - mypy allows no assignment to a method
    return names


def describe_services(server: grpc.aio.Server, names: Sequence[str]) -> None:
    """Serve the reflection service on `server`. Call it before the server starts."""
    from grpc_reflection.v1alpha import reflection  # not at the top: few services need it

    reflection.enable_server_reflection([*names, reflection.SERVICE_NAME], server)
