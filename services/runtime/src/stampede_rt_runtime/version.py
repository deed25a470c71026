"""Which software and which wire contract this is; exchanged when a caller binds."""

from __future__ import annotations

from functools import cache
from importlib import metadata

PROTOCOL_VERSION = 1  # of proto/stampede_rt/v1; grows only when old callers cannot go on


@cache
def software_version() -> str:
    """The version of the installed distribution, the same for client and services."""
    return metadata.version("stampede-rt")
