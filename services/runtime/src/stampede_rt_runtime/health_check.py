"""Asks a service on this machine whether it serves: `python -m stampede_rt_runtime.health_check [HOST:PORT]`.

With `--live` it asks whether the process answers at all. A host without its lease and a supernode without a leader are
alive, but not ready.

Used by the health checks of containers, which have no other client of the standard gRPC health service. That service
needs no secret. With certificates, this program uses the certificates of the service on this machine:
$STAMPEDE_HOST_TLS_CA, ..._CERTIFICATE and ..._KEY name them, or the same variables with FRONTEND or SUPERNODE for HOST.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence

import grpc
from grpc_health.v1 import health_pb2, health_pb2_grpc

from stampede_rt.errors import StampedeError
from stampede_rt.escaping import escaped
from stampede_rt.security.tls import CLIENT_VARIABLES, TlsFiles, TlsReader, files_from_environment
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt_runtime.certificates import CertificateError, describe
from stampede_rt_runtime.health import LIVENESS, READINESS
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.values import Address, parse_address

LIVE = "--live"
EXIT_SERVING, EXIT_NOT_SERVING, EXIT_BAD_ADDRESS = 0, 1, 2
TIMEOUT_SECONDS = 3.0
# a service can listen at a wildcard address, but no caller can call one
_LOOPBACK_OF_WILDCARD = {"0.0.0.0": "127.0.0.1", "::": "::1"}


def own_address(argv: Sequence[str], environ: Mapping[str, str]) -> str:
    """The address in `argv`, or else the address at which the service on this machine listens ($STAMPEDE_LISTEN).

    Raises ValueError if there is no address, or if no caller can call it.
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


def open_channel(target: str, files: TlsFiles | None) -> grpc.Channel:
    """A channel to the service on this machine. Raises PermissionDenied or CertificateError if `files` are
    unusable.

    The called address need not be in the certificate, because the certificate is this machine's own.
    """
    options = Limits().channel_options()
    if files is None:
        return grpc.insecure_channel(target, options=options)
    material = TlsReader(files).current()
    addresses = describe(material.certificate)[0].addresses
    if addresses:
        options.append(("grpc.ssl_target_name_override", addresses[0]))
    return grpc.secure_channel(target, channel_credentials(material), options=options)


def status_of(
    target: str, timeout_seconds: float = TIMEOUT_SECONDS, files: TlsFiles | None = None, *, name: str = READINESS
) -> str:
    """The answer of the service at `target`: `SERVING`, `NOT_SERVING`, or the reason why there is none.

    `name`: READINESS or LIVENESS.

    Blocks for `timeout_seconds` at most. A failed call raises nothing: such a service is not healthy. For the errors of
    unusable `files` see `open_channel`.
    """
    with open_channel(target, files) as channel:
        stub = health_pb2_grpc.HealthStub(channel)
        try:
            answer = stub.Check(health_pb2.HealthCheckRequest(service=name), timeout=timeout_seconds)
        except grpc.RpcError as error:
            return f"{error.code().name}: {error.details()}"
    return str(health_pb2.HealthCheckResponse.ServingStatus.Name(answer.status))


def _files_of_service(environ: Mapping[str, str]) -> TlsFiles | None:
    """The certificates of the first service that has some.

    Raises InvalidArgument if only some of a service's files are named.
    """
    for service in ("HOST", "FRONTEND", "SUPERNODE"):
        variables = tuple(name.replace("STAMPEDE_", f"STAMPEDE_{service}_") for name in CLIENT_VARIABLES)
        if (found := files_from_environment(environ, variables)) is not None:
            return found
    return None


def main(argv: Sequence[str] | None = None) -> int:
    """Returns the exit code. 0: the service serves (with `--live`: lives); 1: it does not; 2: its address is unusable.

    Prints a line with the reason on stdout or stderr.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    name = LIVENESS if LIVE in words else READINESS
    try:
        target = own_address([one for one in words if one != LIVE], os.environ)
    except ValueError as error:
        sys.stderr.write(f"health check: {escaped(str(error))}\n")
        return EXIT_BAD_ADDRESS
    try:
        status = status_of(target, files=_files_of_service(os.environ), name=name)
    except (StampedeError, CertificateError) as error:
        status = str(error)
    sys.stdout.write(escaped(f"{target}: {status}") + "\n")
    return EXIT_SERVING if status == "SERVING" else EXIT_NOT_SERVING


if __name__ == "__main__":
    sys.exit(main())
