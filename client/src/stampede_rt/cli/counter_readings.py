"""Reads the counters of all matching channels, at all hosts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stampede_rt.cli.channel_rates import CounterReading
from stampede_rt.errors import StampedeError

if TYPE_CHECKING:
    from stampede_rt import Connection


def read_counters(rt: Connection, glob: str) -> CounterReading:
    """Return the counters of all matching channels. Leaves out hosts that do not answer."""
    found: dict[str, tuple[str, Any]] = {}
    owners = owners_of(rt, glob)
    for host in rt.hosts():
        try:
            hosted = rt.hosted_channels(host.name, glob)
        except StampedeError:
            continue
        found |= {name: (host.name, stats) for name, stats in hosted.items() if owners.get(name) == host.name}
    return found


def owners_of(rt: Connection, glob: str) -> dict[str, str]:
    """Return the owner of each matching channel, by the channel's name.

    A host lists its copies of other hosts' channels, too.
    """
    return {one.name: one.host for one in rt.channels(glob)}
