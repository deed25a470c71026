"""Checks of a host's own words: by its certificate, if the cluster has them, and by the protocol it speaks. Pure."""

from __future__ import annotations

from stampede_rt.errors import PermissionDenied, VersionMismatch
from stampede_rt.version import PROTOCOL_VERSION, VERSION
from stampede_rt_runtime.identity import Identity


def check_host_caller(caller: Identity | None, *, known_as: str | None, name: str | None) -> None:
    """`known_as`: the name of the host in the directory, None if it is new; `name`: the one it wants, None as it is.

    Without certificates (`caller` is None) every caller is believed. Raises PermissionDenied.
    """
    if caller is None:
        return
    for told in (name, known_as):
        if told is not None and told != caller.name:
            raise PermissionDenied(
                f"{caller} cannot speak for host {told}: its certificate must bear that name; "
                f"issue one with `stampede certs issue --role host --name {told}`"
            )


def check_protocol(spoken: int, version: str) -> None:
    """`spoken` is 0 for a host of before it was told. Raises VersionMismatch."""
    if spoken not in (0, PROTOCOL_VERSION):
        raise VersionMismatch(
            f"the host (version {version}) speaks protocol {spoken}, this directory {PROTOCOL_VERSION} (version "
            f"{VERSION}); install the same release on both",
            metadata={"protocol_version": str(PROTOCOL_VERSION), "version": VERSION},
        )
