"""One look at the counters of all matching channels, at all hosts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stampede_rt.cli.channel_rates import Look
from stampede_rt.errors import StampedeError

if TYPE_CHECKING:
    from stampede_rt import Connection


def look_at(rt: Connection, glob: str) -> Look:
    """Return the counters of all matching channels. Leaves out hosts that do not answer."""
    found: dict[str, tuple[str, Any]] = {}
    for host in rt.hosts():
        try:
            found |= {name: (host.name, stats) for name, stats in rt.hosted_channels(host.name, glob).items()}
        except StampedeError:
            continue
    return found
