"""A channel host inside the program's own process: its settings, and the package that brings the code of the host.

The client imports no service. The package of the host registers a function as an entry point, and `embedder` finds it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from stampede_rt.cluster.connecting import Target
from stampede_rt.errors import InvalidArgument
from stampede_rt.values.policy import flag_of, memory_of
from stampede_rt.values.timeline import DurationLike, parse_duration

ENTRY_POINTS = "stampede_rt.embedded_hosts"
START_TIMEOUT_S = 15.0  # the lease of a predecessor with the same name ends within 6 s
DRAIN_MAX_NANOS = 3600 * 10**9


@dataclass(frozen=True, kw_only=True, slots=True)
class HostOptions:
    """The arguments of `stampede_rt.host` that concern the host.

    `listen` and `advertise`: empty if not given; the host checks them.
    """

    listen: str
    advertise: str
    memory_bytes_max: int
    drain_s: float
    allow_insecure_anywhere: bool

    @classmethod
    def parse(
        cls,
        listen: str | None,
        advertise: str | None,
        max_memory: int | str,
        drain: DurationLike,
        allow_insecure_anywhere: bool,
    ) -> HostOptions:
        """Check the arguments. Raises InvalidArgument."""
        drain_nanos = parse_duration(drain, "drain")
        if not 0 <= drain_nanos <= DRAIN_MAX_NANOS:
            raise InvalidArgument(f'drain is {drain!r}; it must be from "0s" to "1h"')
        return cls(
            listen=listen or "",
            advertise=advertise or "",
            memory_bytes_max=memory_of("max_memory", max_memory),
            drain_s=drain_nanos / 1e9,
            allow_insecure_anywhere=flag_of("allow_insecure_anywhere", allow_insecure_anywhere),
        )


class HostHere(Protocol):
    """A channel host in this process. Several threads may use it."""

    @property
    def name(self) -> str:
        """The host's name in the directory."""
        ...

    @property
    def target(self) -> str:
        """The address at which others reach the host."""
        ...

    def start(self, timeout_s: float) -> None:
        """Start the host on a thread of its own, and wait until the directory knows it. Raises StampedeError."""
        ...

    def leave(self) -> None:
        """Move the channels to other hosts, deregister the host, and end its thread. Idempotent.

        Blocks for the drain and for some seconds more. In a forked child it does nothing.
        """
        ...


Embedder = Callable[[Target, HostOptions], HostHere]


def embedder() -> Embedder:
    """Return the function that makes a host for this process. Raises InvalidArgument if no package has it."""
    from importlib.metadata import entry_points

    for point in entry_points(group=ENTRY_POINTS):
        found: Embedder = point.load()
        return found
    raise InvalidArgument(
        "this process cannot host channels, because the code of the host is not installed: it belongs to the extra "
        "[server] of stampede-rt; install that extra from where stampede-rt came from, or run `make setup` in a clone "
        "of the repository"
    )
