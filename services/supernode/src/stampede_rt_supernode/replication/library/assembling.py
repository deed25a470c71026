"""Puts a node of the library together, under rules that stand before its class in the order of methods."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from typing import Any

from stampede_rt_supernode.replication.library.node import RandomSource
from stampede_rt_supernode.replication.library.pinned_copy import load_library
from stampede_rt_supernode.replication.library.seams import LibraryLog, LibrarySerializer, LibraryTransport
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.wire.buffered_transport import BufferedTransport


class Assembly:
    """One private copy of the library. Raises LibraryMismatch."""

    def __init__(self, *, clock: Callable[[], float], random_source: RandomSource) -> None:
        self._library = load_library(clock=clock, random_source=random_source)
        # The library walks over sets of members: a hash of our own keeps that order the same in every process, and a
        # simulated run replayable.
        self.make_member: Callable[[str], Any] = type(
            "MemberNode", (self._library.Node,), {"__hash__": lambda member: zlib.crc32(member.id.encode())}
        )

    def allocate(self, rules: type) -> Any:
        """A node without state. The library's constructor already calls back: attach what its methods need first."""
        node_class: Any = type("RaftNode", (rules, self._library.SyncObj), {})
        return node_class.__new__(node_class)

    def construct(
        self,
        node: Any,
        settings: ReplicationSettings,
        *,
        others: Iterable[Any],
        log: RaftLog,
        keeper: SnapshotKeeper,
        transport: BufferedTransport,
    ) -> None:
        """Run the library's constructor: a follower with what `log` holds, and no snapshot open yet."""
        serializer = LibrarySerializer(keeper, log)
        conf = self._conf(settings, LibraryLog(log), serializer)
        self_member = self.make_member(settings.self_member.member_id)
        node.__init__(self_member, others, conf=conf, transport=LibraryTransport(transport))

    def _conf(self, settings: ReplicationSettings, log: LibraryLog, serializer: LibrarySerializer) -> Any:
        """The library's configuration, every value that matters named."""
        timing = settings.timing
        return self._library.SyncObjConf(
            autoTick=False,
            appendEntriesUseBatch=False,
            appendEntriesPeriod=timing.heartbeat_seconds,
            raftMinTimeout=timing.election_timeout_min_seconds,
            raftMaxTimeout=timing.election_timeout_max_seconds,
            connectionTimeout=max(3.5, timing.election_timeout_max_seconds),
            leaderFallbackTimeout=timing.leader_fallback_seconds,
            commandsWaitLeader=False,
            commandsQueueSize=settings.proposals_max,
            logCompactionMinEntries=settings.snapshot_every_entries,
            logCompactionMinTime=settings.snapshot_every_seconds,
            journalFile=log,
            fullDumpFile="(in the store)",
            serializer=serializer,
            deserializer=serializer.deserialize,
            useFork=False,
            dynamicMembershipChange=False,
        )
