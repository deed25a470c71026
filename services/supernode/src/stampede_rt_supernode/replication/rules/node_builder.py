"""Builds a node with its objects. The class of a node inherits from our rules, and then from the library's class."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_supernode.replication.configuration import Configuration
from stampede_rt_supernode.replication.interface import StateMachine
from stampede_rt_supernode.replication.library.assembling import LibraryCopy
from stampede_rt_supernode.replication.library.node import RandomSource
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedReads
from stampede_rt_supernode.replication.rules.digests import DigestPoll, Digests
from stampede_rt_supernode.replication.rules.elections import PreVoteElections
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.snapshots import SnapshotKeeper
from stampede_rt_supernode.replication.threads.worker_thread import RunInBackground, run_inline
from stampede_rt_supernode.replication.wire.buffered_transport import BufferedTransport


def build_node(
    settings: ReplicationSettings,
    state_machine: StateMachine,
    *,
    log: RaftLog,
    has_room: Callable[[str], bool],
    clock: Callable[[], float],
    random_source: RandomSource,
    rules: type = PreVoteElections,
    run_in_background: RunInBackground = run_inline,
) -> PreVoteElections:
    """Returns a node with its transport, snapshot keeper and reads. The node has not opened its snapshot yet.

    `has_room` returns whether the link to a member accepts more entries or pieces of a snapshot. `rules` is the class
    of our rules. It comes before the library's class in the method resolution order. Raises LibraryMismatch if another
    version of the library is installed.
    """
    assembly = LibraryCopy(clock=clock, random_source=random_source)
    self_id = settings.self_member.member_id
    peers = {member.member_id: member for member in settings.initial_members if member.member_id != self_id}
    others = [assembly.make_member(member_id) for member_id in peers]
    log.track_members(Configuration.of(settings.initial_members))
    node: PreVoteElections = assembly.allocate(rules)
    node.clock, node.state_machine, node.has_room = clock, state_machine, has_room
    node.peers, node.make_member = peers, assembly.make_member
    _begin_rules(node, settings)
    node.keeper = SnapshotKeeper(
        log, state_machine, has_room, run_in_background=run_in_background, chunk_bytes=settings.snapshot_piece_bytes
    )
    # Request ids begin at a random number. So a late answer to a former process of this member does not have the id of
    # a new request.
    first_request_id = int(random_source.random() * 2**52)
    node.transport = BufferedTransport(others)
    node.reads = ConfirmedReads(
        node,
        node.transport,
        clock,
        retry_seconds=settings.timing.read_retry_seconds,
        first_request_id=first_request_id,
    )
    assembly.construct(node, settings, others=others, log=log, keeper=node.keeper, transport=node.transport)
    node.transport.attach(node)
    node.number_forwarded_after(first_request_id)
    return node


def _begin_rules(node: PreVoteElections, settings: ReplicationSettings) -> None:
    """Give the fields of our rules their first values. The node has its clock, state machine and peers already."""
    node.digests, node.poll = Digests(node.state_machine.adopt_digest), DigestPoll()
    node.self_member, node._named = settings.self_member, dict(node.peers)
    node._strangers, node.disputed_by, node.had_leader_at = {}, {}, node.clock()
    node._answered_at = {}
    node.locked_out_seconds = 2 * settings.timing.election_timeout_max_seconds
    node.leader_alive_seconds = settings.timing.election_timeout_min_seconds / 2
