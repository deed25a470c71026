"""Keeps the loads that hosts report with their renewals, and notes changed loads in the log.

A part of `lease_keeper`, used on its event loop. It notes loads at most once in NOTE_NANOS. One entry of the log has
the loads of up to HOSTS_PER_ENTRY_MAX hosts. While no load changes, there are no entries.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from dataclasses import replace

from stampede_rt_runtime.clock import HostClock
from stampede_rt_supernode.core.cluster.feature_levels import LOADS_LEVEL
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.hosts.commands import HostLoadsNoted, NoteHostLoads, ReportedLoad
from stampede_rt_supernode.core.records import ID_BYTES, HostLoad, HostRecord
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers.submission import Submission

NOTE_NANOS = 2 * 10**9
HOSTS_PER_ENTRY_MAX = 512
CHANGE_PERMILLE = 50  # a load that has changed by less is not noted
PROPOSAL_SECONDS = 5.0


class HostLoads:
    """The loads that hosts reported to this leader, at most one for each live host."""

    def __init__(self, replica: DirectoryReplica, submission: Submission, clock: HostClock) -> None:
        self._replica = replica
        self._submission = submission
        self._clock = clock
        self._reported: dict[bytes, HostLoad] = {}
        self._owned: dict[bytes, int] = {}  # the number of channels and queues that each host owned at its last report
        self._noted_nanos = 0

    def note(self, host_id: bytes, load: HostLoad) -> None:
        """Note the load that a host reports with its renewal.

        The host measured it since its previous report. So the load does not fully include channels that the host got
        meanwhile.
        """
        owned = self._replica.read(lambda directory: _owned(directory, host_id))
        self._reported[host_id] = replace(load, owned=min(owned, self._owned.get(host_id, owned)))
        self._owned[host_id] = owned

    def forget(self) -> None:
        """Forget all reports, because this supernode no longer leads."""
        self._reported, self._owned = {}, {}

    async def tick(self, tenure: int) -> None:
        """Note the changed loads in the log, if the last note is long enough ago. Raises StampedeError."""
        now = self._clock.boottime_nanos()
        if not self._reported or now - self._noted_nanos < NOTE_NANOS:
            return
        self._noted_nanos = now
        changed = self._replica.read(lambda directory: list(self._changed(directory)))
        for start in range(0, len(changed), HOSTS_PER_ENTRY_MAX):
            operation = NoteHostLoads(tenure=tenure, loads=tuple(changed[start : start + HOSTS_PER_ENTRY_MAX]))
            await self._submission.submit(
                operation, HostLoadsNoted, op_id=secrets.token_bytes(ID_BYTES), seconds=PROPOSAL_SECONDS
            )

    def _changed(self, directory: Directory) -> Iterator[ReportedLoad]:
        """The loads that differ from the directory's. Forgets the loads of hosts that are gone."""
        if directory.feature_level < LOADS_LEVEL:
            return
        for host_id, load in list(self._reported.items()):
            host = directory.tables.hosts.get(host_id)
            if host is None or not host.alive:
                del self._reported[host_id]
                self._owned.pop(host_id, None)
            elif differs(host, load):
                yield ReportedLoad(host_id=host_id, registered_index=host.registered_index, load=load)


def differs(host: HostRecord, load: HostLoad) -> bool:
    """Whether the load differs enough from that in the record to be noted."""
    known = host.load
    if known is None:
        return True
    memory_change = abs(load.held_bytes - known.held_bytes) * 1000
    return (
        abs(load.busy_permille - known.busy_permille) >= CHANGE_PERMILLE
        or memory_change >= CHANGE_PERMILLE * max(load.bytes_max, 1)
        or _facts(load) != _facts(known)
    )


def _facts(load: HostLoad) -> tuple[object, ...]:
    return load.owned, load.bytes_max, load.has_archive, load.is_private, load.machine


def _owned(directory: Directory, host_id: bytes) -> int:
    host = directory.tables.hosts.get(host_id)
    return 0 if host is None else host.channels + directory.tables.queues.count_at(host_id)
