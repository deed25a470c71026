"""Puts one node together: the library's class under our rules, and everything it needs around it."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import StateMachine
from stampede_rt_supernode.replication.library.pinned_copy import Dice, load_library
from stampede_rt_supernode.replication.rules.digests import Digests
from stampede_rt_supernode.replication.rules.elections import TrialElections
from stampede_rt_supernode.replication.rules.proposals import UNKNOWN_OUTCOME
from stampede_rt_supernode.replication.rules.reads import ConfirmedReads
from stampede_rt_supernode.replication.settings import RaftTiming, ReplicationSettings
from stampede_rt_supernode.replication.storage.journal import Journal
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.threads.aside import RunAside, run_at_once
from stampede_rt_supernode.replication.wire.mailroom import Mailroom

APPEND_BATCH_BYTES = 1 << 20


def build_node(
    settings: ReplicationSettings,
    state_machine: StateMachine,
    *,
    journal: Journal,
    has_room: Callable[[str], bool],
    clock: Callable[[], float],
    dice: Dice,
    rules: type = TrialElections,
    run_aside: RunAside = run_at_once,
) -> Any:
    """A node with its mailroom, keeper and reads attached; its snapshot is not opened yet.

    `rules` stands before the library's class in the order of methods. Raises LibraryMismatch.
    """
    library = load_library(clock=clock, dice=dice)
    self_id = settings.self_member.member_id
    # The library walks over sets of nodes: a hash of our own keeps that order the same in every process, and a
    # simulated run replayable.
    node_type: Any = type("MemberNode", (library.Node,), {"__hash__": lambda node: zlib.crc32(node.id.encode())})
    peers = {member.member_id: member for member in settings.initial_members if member.member_id != self_id}
    others = [node_type(member_id) for member_id in peers]
    journal.track_members(Configuration.of(settings.initial_members))
    node_class: Any = type("RaftNode", (rules, library.SyncObj), {})
    # The library's constructor already calls back, so what its methods need is attached before it runs.
    node = node_class.__new__(node_class)
    node.clock, node.state_machine, node.has_room = clock, state_machine, has_room
    node.unknown_outcome, node.digests = UNKNOWN_OUTCOME, Digests()
    node.self_member, node.make_node, node.peers, node._told = settings.self_member, node_type, peers, dict(peers)
    node.keeper = SnapshotKeeper(
        journal, state_machine, has_room, run_aside=run_aside, chunk_bytes=settings.snapshot_piece_bytes
    )
    node.leader_alive_seconds = settings.timing.election_timeout_min_seconds / 2
    # Request ids of an earlier life must not be answered in this one.
    first_request_id = int(dice.random() * 2**52)
    _attach_mail_and_reads(node, others, clock, settings.timing, first_request_id)
    conf = library_conf(library, settings, journal, node.keeper)
    node.__init__(node_type(self_id), others, conf=conf, transport=node.mailroom)
    node._SyncObj__commandsLocalCounter = first_request_id
    return node


def _attach_mail_and_reads(
    node: Any, others: list[Any], clock: Callable[[], float], timing: RaftTiming, first_request_id: int
) -> None:
    node.mailroom = Mailroom(others)
    node.mailroom.on_stream_opened = node.on_stream_opened
    node.mailroom.on_members_told = node.on_members_told
    node.mailroom.on_introduced = node.on_introduced
    node.reads = ConfirmedReads(
        node, node.mailroom, clock, retry_seconds=timing.read_retry_seconds, first_request_id=first_request_id
    )


def library_conf(library: Any, settings: ReplicationSettings, journal: Journal, keeper: SnapshotKeeper) -> Any:
    """The library's configuration, every value that matters named."""
    timing = settings.timing
    return library.SyncObjConf(
        autoTick=False,
        appendEntriesUseBatch=False,
        appendEntriesPeriod=timing.heartbeat_seconds,
        raftMinTimeout=timing.election_timeout_min_seconds,
        raftMaxTimeout=timing.election_timeout_max_seconds,
        connectionTimeout=max(3.5, timing.election_timeout_max_seconds),
        leaderFallbackTimeout=timing.leader_fallback_seconds,
        commandsWaitLeader=False,
        commandsQueueSize=settings.proposals_max,
        appendEntriesBatchSizeBytes=APPEND_BATCH_BYTES,
        logCompactionMinEntries=settings.snapshot_every_entries,
        logCompactionMinTime=settings.snapshot_every_seconds,
        journalFile=journal,
        fullDumpFile="(in the store)",
        serializer=keeper,
        deserializer=keeper.deserialize,
        useFork=False,
        dynamicMembershipChange=False,
    )
