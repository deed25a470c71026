"""Which software and which wire contract this is; exchanged when a caller binds."""

from __future__ import annotations

from stampede_rt.version import PROTOCOL_VERSION, VERSION

__all__ = ["PROTOCOL_VERSION", "software_version"]


def software_version() -> str:
    """The version of this software, the same for client and services: the workspace has one."""
    return VERSION
