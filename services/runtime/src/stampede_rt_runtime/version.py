"""The versions of this software and of its wire contract. Callers and services exchange them at bind."""

from __future__ import annotations

from stampede_rt.version import PROTOCOL_VERSION, VERSION

__all__ = ["PROTOCOL_VERSION", "software_version"]


def software_version() -> str:
    """The version of this software. Client and services have the same version."""
    return VERSION
