"""Checks of the arguments of `connect`: addresses, the secret, certificates, the peer's name and zone."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt.cluster.addresses import DEFAULT_URL, is_loopback, parse_addresses
from stampede_rt.cluster.transport_choice import Transport, parse_transport
from stampede_rt.errors import PermissionDenied
from stampede_rt.security.credentials import Credentials, SecretReader, secret_file
from stampede_rt.security.tls import TlsFiles, TlsReader, files_from_environment
from stampede_rt.values.policy import parse_name


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """The checked arguments of `connect`: front-ends, the peer's name, zone and credentials."""

    frontends: tuple[str, ...]
    secret: str | SecretReader | None = field(repr=False)
    name: str
    zone: str
    tls: TlsReader | None = None
    transport: Transport = Transport.GRPC

    @property
    def credentials(self) -> Credentials:
        """The credentials for all calls."""
        return Credentials(secret=self.secret, tls=self.tls)


def parse_target(
    url: str | None,
    *,
    name: str | None,
    secret: str | os.PathLike[str] | None,
    zone: str | None,
    tls: TlsFiles | None = None,
    transport: str | None = None,
) -> Target:
    """Check the arguments of `connect`.

    - `url`: front-ends, "host:port,..."; default `$STAMPEDE_URL`, then localhost:7580.
    - `secret`: the secret or token, or the path of its file. Without it the client takes the file that
      `$STAMPEDE_SECRET_FILE` names. If that is not set, the client takes the user's own secret file (see
      `secret_file`), but only if all addresses are on this machine. No other machine then gets the secret. The client
      reads a file again when it has changed.
    - `tls`: without it the client takes the certificates that `$STAMPEDE_TLS_CA`, `$STAMPEDE_TLS_CERTIFICATE` and
      `$STAMPEDE_TLS_KEY` name, if these are set.
    - `transport`: see `parse_transport`.

    Raises InvalidArgument, PermissionDenied.
    """
    frontends = parse_addresses(url or os.environ.get("STAMPEDE_URL") or DEFAULT_URL)
    files = tls or files_from_environment(os.environ)
    return Target(
        frontends=frontends,
        secret=_secret_for(frontends) if secret is None else secret if isinstance(secret, str) else _secret_in(secret),
        name="" if name is None else parse_name(name, "peer"),
        zone=zone or os.environ.get("STAMPEDE_ZONE", ""),
        tls=TlsReader(files) if files else None,
        transport=parse_transport(transport),
    )


def _secret_for(frontends: tuple[str, ...]) -> SecretReader | None:
    named = os.environ.get("STAMPEDE_SECRET_FILE")
    if not named and not all(map(is_loopback, frontends)):
        return None
    found = SecretReader(secret_file())
    if named and not found.current():
        raise PermissionDenied(
            f"$STAMPEDE_SECRET_FILE names {named}, where there is no secret; name the file of the cluster's secret, or "
            "unset the variable"
        )
    return found


def _secret_in(path: str | os.PathLike[str]) -> SecretReader:
    found = SecretReader(Path(path))
    if not found.current():
        raise PermissionDenied(f"{path} holds no secret or token; name another file, or give the text itself")
    return found
