"""Decides whether a recorded channel waits for its host, which is unreachable (decision 0318). Pure.

Only this host has the archived items, in its own folder. So the channel waits for a limited time before another host
takes it over. The directory reads no clock. The supernode measures the time, and its command names the registration for
which it has waited.
"""

from __future__ import annotations

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.channels.commands import OpenChannel
from stampede_rt_supernode.core.records import HostRecord
from stampede_rt_supernode.core.tables import Tables


def awaited_host(tables: Tables, name: str) -> HostRecord | None:
    """The host for which the channel `name` waits, however long it has waited already; None: it waits for none.

    The channel does not wait if another host has taken the name of its host.
    """
    channel = tables.channel_named(name)
    if channel is None or not channel.policy.is_recorded:
        return None
    host = tables.hosts[channel.host_id]
    is_away = not host.alive and tables.live_host_named(host.name) is None
    return host if is_away and host.archive_wait_nanos > 0 else None


def check_waited(tables: Tables, operation: OpenChannel) -> None:
    """Raises Unavailable with reason NO_HOST if the channel must still wait for its host."""
    host = awaited_host(tables, operation.name)
    if host is None or host.registered_index == operation.waited_for_index:
        return
    raise Unavailable(
        f"channel {operation.name} waits for host {host.name}, which is unreachable, because only its folder has the "
        f"archive of the channel; start host {host.name} again; {host.archive_wait_nanos / 1e9:g} s after the first "
        "call, another host takes the channel over without its archive",
        reason="NO_HOST",
        metadata={"channel": operation.name, "host": host.name},
    )
