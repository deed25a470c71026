"""Builds a node of the library. Our rules come before the library's class in the method resolution order."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from typing import Any

from stampede_rt_supernode.replication.library.adapters import LibraryLog, LibrarySerializer, LibraryTransport
from stampede_rt_supernode.replication.library.node import RandomSource
from stampede_rt_supernode.replication.library.pinned_copy import load_library
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.wire.buffered_transport import BufferedTransport


class LibraryCopy:
    """One private copy of the library. `make_member` makes the library's node for the id of a member."""

    def __init__(self, *, clock: Callable[[], float], random_source: RandomSource) -> None:
        """Load the copy. Raises LibraryMismatch."""
        self._library = load_library(clock=clock, random_source=random_source)
        # The library scans sets of members. This hash gives the same order in every process, so that a simulated
        # run can be repeated.
        self.make_member: Callable[[str], Any] = type(
            "MemberNode", (self._library.Node,), {"__hash__": lambda member: zlib.crc32(member.id.encode())}
        )

    def allocate(self, rules: type) -> Any:
        """A node without state.

        Attach the objects that its methods need before `construct`: the library's constructor calls these methods.
        """
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
        """Run the library's constructor. It makes the node a follower with the entries of `log`, without a snapshot."""
        serializer = LibrarySerializer(keeper, log)
        conf = self._conf(settings, LibraryLog(log), serializer)
        self_member = self.make_member(settings.self_member.member_id)
        node.__init__(self_member, others, conf=conf, transport=LibraryTransport(transport))

    def _conf(self, settings: ReplicationSettings, log: LibraryLog, serializer: LibrarySerializer) -> Any:
        """The library's configuration. It states every value that has an effect here."""
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
