"""Asks a service on this machine whether it serves: `python -m stampede_rt_runtime.health_check [HOST:PORT]`.

For the health checks of containers, which have no other client of the standard gRPC health service at hand. That
service answers without a secret, so none is needed here.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.values import Address, parse_address

EXIT_SERVING, EXIT_NOT_SERVING, EXIT_BAD_ADDRESS = 0, 1, 2
TIMEOUT_SECONDS = 3.0
_LOOPBACK_OF_WILDCARD = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # a wildcard can be listened at, not called


def own_address(argv: Sequence[str], environ: Mapping[str, str]) -> str:
    """The address in `argv`, or else the one that the service beside us was told to listen at ($STAMPEDE_LISTEN).

    Raises ValueError if there is neither, or if it cannot be called.
    """
    named = [*argv, environ.get("STAMPEDE_LISTEN", "")][0]
    if len(argv) > 1 or not named:
        raise ValueError("give one HOST:PORT, or set $STAMPEDE_LISTEN to where the service listens")
    try:
        address = parse_address(named)
    except ValueError as error:
        raise ValueError(f"{named!r} cannot be called; allowed: {error}") from None
    if address.port == 0:
        raise ValueError(f"{named!r} cannot be called: the port must be known, not 0")
    return str(Address(_LOOPBACK_OF_WILDCARD.get(address.host, address.host), address.port))


def status_of(target: str, timeout_seconds: float = TIMEOUT_SECONDS) -> str:
    """What the service at `target` says of itself: `SERVING`, `NOT_SERVING`, or why it could not be asked.

    Blocks for `timeout_seconds` at most. Raises nothing: a service that cannot be asked is not healthy.
    """
    with grpc.insecure_channel(target, options=Limits().channel_options()) as channel:
        stub = health_pb2_grpc.HealthStub(channel)
        try:
            answer = stub.Check(health_pb2.HealthCheckRequest(), timeout=timeout_seconds)
        except grpc.RpcError as error:
            return f"{error.code().name}: {error.details()}"
    return str(health_pb2.HealthCheckResponse.ServingStatus.Name(answer.status))


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0: it serves; 1: it does not; 2: the address cannot be used. One line on stdout or stderr says why."""
    try:
        target = own_address(sys.argv[1:] if argv is None else argv, os.environ)
    except ValueError as error:
        sys.stderr.write(f"health check: {error}\n")
        return EXIT_BAD_ADDRESS
    status = status_of(target)
    sys.stdout.write(f"{target}: {status}\n")
    return EXIT_SERVING if status == "SERVING" else EXIT_NOT_SERVING


if __name__ == "__main__":
    sys.exit(main())
