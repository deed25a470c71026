"""Measures how long the callers of recorded channels have waited for hosts that are unreachable (decision 0318)."""

from __future__ import annotations

from stampede_rt_runtime.clock import HostClock
from stampede_rt_supernode.core.channels.waiting import awaited_host
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.replica import DirectoryReplica


class ArchiveWaits:
    """The waits of this supernode. A wait begins when a caller first opens a channel of the host here.

    So after a start of the whole cluster the hosts have the whole time to register, however long they were unreachable.
    """

    def __init__(self, replica: DirectoryReplica, clock: HostClock) -> None:
        self._replica = replica
        self._clock = clock
        self._began: dict[int, int] = {}  # when each wait began, by the log position of the host's registration

    def waited_for(self, name: str) -> int:
        """The `waited_for_index` for an open of the channel `name`. Begins the wait if there is none yet."""
        host = self._replica.read(lambda directory: awaited_host(directory.tables, name))
        if host is None:
            return 0
        now = self._clock.boottime_nanos()
        if host.registered_index not in self._began:
            away = self._replica.read(_away)
            self._began = {index: began for index, began in self._began.items() if index in away}
            self._began[host.registered_index] = now
        is_over = now - self._began[host.registered_index] >= host.archive_wait_nanos
        return host.registered_index if is_over else 0


def _away(directory: Directory) -> set[int]:
    """The registrations of the hosts that are unreachable."""
    return {host.registered_index for host in directory.tables.hosts.values() if not host.alive}
