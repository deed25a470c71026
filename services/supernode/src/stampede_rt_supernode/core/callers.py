"""Checks the certificate of a caller that acts as a host, and the version of its protocol. Pure."""

from __future__ import annotations

from stampede_rt.errors import PermissionDenied, VersionMismatch
from stampede_rt.version import PROTOCOL_VERSION, VERSION
from stampede_rt_runtime.identity import Identity


def check_host_caller(caller: Identity | None, *, registered_name: str | None, new_name: str | None) -> None:
    """Check the caller's certificate for a host.

    `registered_name`: the name of the host in the directory; None for a new host. `new_name`: the name that the caller
    wants for the host; None if the host keeps its name. `caller` is None in a cluster without certificates, where every
    caller passes. Raises PermissionDenied.
    """
    if caller is None:
        return
    for stated in (new_name, registered_name):
        if stated is not None and stated != caller.name:
            raise PermissionDenied(
                f"{caller} cannot speak for host {stated}: its certificate must contain that name; "
                f"issue one with `stampede certs issue --role host --name {stated}`"
            )


def check_protocol(spoken: int, version: str) -> None:
    """Check the host's protocol version, `spoken`. A host of an early release states 0, and passes.

    Raises VersionMismatch.
    """
    if spoken not in (0, PROTOCOL_VERSION):
        raise VersionMismatch(
            f"the host (version {version}) speaks protocol {spoken}, this directory {PROTOCOL_VERSION} (version "
            f"{VERSION}); install the same release on both",
            metadata={"protocol_version": str(PROTOCOL_VERSION), "version": VERSION},
        )
