"""One replica of the log: arrivals, node, log and outbox, driven by `step`.

Clock, random source, network and store come from outside. So the simulator runs the same code as production.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from stampede_rt_runtime.metrics.families import Durations
from stampede_rt_supernode.replication.arrivals import Arrivals, taken_from
from stampede_rt_supernode.replication.interface import LogUnavailable, Member, ReplicationStatus, StateMachine
from stampede_rt_supernode.replication.library.node import RandomSource
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.rules.elections import TERM_MAX, PreVoteElections
from stampede_rt_supernode.replication.rules.leadership_transfer import HandOver
from stampede_rt_supernode.replication.rules.member_change import MemberChange
from stampede_rt_supernode.replication.rules.member_changes import MemberChanges
from stampede_rt_supernode.replication.rules.node_builder import build_node
from stampede_rt_supernode.replication.rules.proposals import Proposal, Proposals
from stampede_rt_supernode.replication.rules.raft_node import PeerAtFault
from stampede_rt_supernode.replication.rules.snapshot_requests import SnapshotRequest, SnapshotRequests
from stampede_rt_supernode.replication.settings import ReplicationSettings
from stampede_rt_supernode.replication.storage.raft_log import RaftLog
from stampede_rt_supernode.replication.storage.store import REJOIN, Promise, Store, StoreDamaged
from stampede_rt_supernode.replication.threads.worker_thread import RunInBackground, run_inline
from stampede_rt_supernode.replication.wire.buffered_transport import NetworkEvent, Outgoing


class RaftNetwork(Protocol):
    """Sends a replica's messages, and ends the streams of faulty members."""

    def release(self, messages: Sequence[Outgoing]) -> None:
        """Send the messages in order, each at most once. Never blocks."""

    def has_room(self, member_id: str) -> bool:
        """Whether the queue to this member accepts more entries or pieces of a snapshot."""

    def drop(self, member_id: str, why: str) -> None:
        """End the stream of a member that breaks the protocol, refuse it for a while, and log that. Never blocks."""

    def follow(self, roster: MemberRoster) -> None:
        """From now on keep links to these peers only. Never blocks."""


@dataclass(frozen=True, slots=True)
class MemberRoster:
    """The members that a replica knows.

    `members` are the members of the newest configuration in the log. `peers`, by id, are the other nodes to which the
    replica keeps links. `removed` has the ids of former members, which the newest applied configuration lists as
    retired.
    """

    members: tuple[Member, ...]
    peers: Mapping[str, Member]
    former_ids: frozenset[str]


class RaftReplica:
    """The synchronous part of a replica.

    Any thread may call the methods under "any thread" below. Only the tick thread may call those under "tick thread".
    """

    def __init__(
        self,
        settings: ReplicationSettings,
        state_machine: StateMachine,
        *,
        store: Store,
        network: RaftNetwork,
        clock: Callable[[], float],
        random_source: RandomSource,
        wake: Callable[[], None] = lambda: None,
        rules: type = PreVoteElections,
        run_in_background: RunInBackground = run_inline,
    ) -> None:
        """Load the state from the store. Blocks.

        `wake` is called after each arrival, so that the next step comes soon. `run_in_background` has another thread
        encode and decode snapshots. Tests pass `rules` with faults. Raises StoreDamaged, LibraryMismatch, and the
        errors of the state machine for an unreadable snapshot.
        """
        self._settings = settings
        self._network = network
        self._clock = clock
        self._wake = wake
        self._arrivals = Arrivals(settings)
        # Calls that give callers their results. They wait until all changes of the step are durable.
        self._completions: list[Callable[[], None]] = []
        self._log = RaftLog(store, kept_bytes_max=settings.kept_log_bytes_max)
        self._state_machine = state_machine
        self._node = self._open_node(state_machine, random_source, rules, run_in_background)
        self._proposals = Proposals(self._node.propose, self._completions.append, submitted_max=settings.proposals_max)
        self._changes = self._make_changes()
        self._snapshots = SnapshotRequests(self._node, self._log, self._completions.append)
        self._roster_version: tuple[object, ...] = ()
        self.roster = MemberRoster((), {}, frozenset())
        # This write shows the next process that opens the store that the store was used.
        self._log.sync()
        # (term, last log index) on stable storage, as this member states them in its hellos
        self.durable_end = self._log.end()
        self._publish_roster()
        self._status = self._observe()

    def _open_node(
        self, state_machine: StateMachine, random_source: RandomSource, rules: type, run_in_background: RunInBackground
    ) -> PreVoteElections:
        node = build_node(
            self._settings,
            state_machine,
            log=self._log,
            has_room=self._network.has_room,
            clock=self._clock,
            random_source=random_source,
            rules=rules,
            run_in_background=run_in_background,
        )
        node.open_snapshot()
        last_term, _ = node.log_end()
        if node.term > TERM_MAX:
            raise StoreDamaged(
                f"this member is in term {node.term}, and its log ends in term {last_term}: no elections explain that, "
                f"so a hostile member has raised its term. {REJOIN}; if all supernodes say so, make a new cluster "
                "from the folder of one of them, which loses nothing that it holds (stampede supernode init --restore)"
            )
        return node

    def _make_changes(self) -> MemberChanges:
        timing = self._settings.timing
        return MemberChanges(
            self._node,
            self._clock,
            self._completions.append,
            round_seconds=timing.election_timeout_min_seconds,
            alive_seconds=timing.leader_fallback_seconds,
        )

    # -- any thread ----------------------------------------------------------------------------------------------

    def deliver(self, event: NetworkEvent) -> None:
        """Queue a network event. Raises InboxFull if too many messages of that member wait. Other events always fit."""
        self._arrivals.add_event(event)
        self._wake()

    def propose(self, proposal: Proposal) -> None:
        """Queue a command. Raises LogUnavailable if too many wait, ValueError if it is too large."""
        self._arrivals.add_proposal(proposal)
        self._wake()

    def read(self, read: ConfirmedRead) -> None:
        """Queue a confirmed read. Raises LogUnavailable if too many wait."""
        self._arrivals.add_read(read)
        self._wake()

    def change_members(self, change: MemberChange | HandOver) -> None:
        """Queue a change of the members, or a hand-over. Raises LogUnavailable if too many wait."""
        self._arrivals.add_change(change)
        self._wake()

    def take_snapshot(self, request: SnapshotRequest) -> None:
        """Queue a request for a snapshot. Raises LogUnavailable if too many wait."""
        self._arrivals.add_snapshot_request(request)
        self._wake()

    def can_begin_change(self) -> bool:
        """Whether this replica leads and no change of the members is under way, as of the last step."""
        return bool(self._node.may_change_members()) and self._changes.is_idle and not self._arrivals.changes

    def promise_of(self, member_id: str) -> Promise:
        """The promise of another member: the term and the committed entries that its store must hold."""
        return self._log.promises.get(member_id, Promise(0, 0))

    def status(self) -> ReplicationStatus:
        """The status as of the last step."""
        return self._status

    def write_times(self) -> Durations:
        """The durations of the writes to the store."""
        return self._log.write_times

    @property
    def highest_level(self) -> int:
        """The highest feature level that this release knows."""
        return self._state_machine.highest_level

    @property
    def feature_level(self) -> int:
        """The state's feature level."""
        return self._state_machine.feature_level

    # -- tick thread ---------------------------------------------------------------------------------------------

    def step(self) -> bool:
        """Process the arrivals, advance, and release everything that is now on stable storage. Blocks only on the disk.

        Returns True if another step is due immediately. After any exception the caller must stop the replica.
        """
        self._receive_events()
        self._log.sync()
        self._accept_requests()
        self._node.keeper.begin_step()
        self._drop_if_at_fault(self._node.install_opened)
        self._node.step_down_if_diverged()
        self._node.before_tick()
        confirm = self._node.reads.start_round()
        self._node.tick()
        if confirm:
            self._node.send_now()
        self._node.reads.finish()
        self._changes.advance()
        self._snapshots.advance()
        if self._node.is_leader:
            self._node.note_promises()
        self._node.free_sent_entries()
        self._log.sync()
        self._release()
        return bool(self._arrivals.events) or self._commits_alone()

    def pause_seconds(self) -> float:
        """The longest time until the next step, unless something arrives. It is longer if nothing waits."""
        node = self._node
        alone = node.is_leader and not node.peers and node.last_applied == self._log.last_index
        parts = (self._proposals, node.reads, self._changes, self._snapshots)
        idle = alone and not node.keeper.is_busy and all(part.is_idle for part in parts)
        return self._settings.timing.idle_seconds if idle else self._settings.timing.tick_seconds

    def _receive_events(self) -> None:
        for event in self._arrivals.take_events():
            self._drop_if_at_fault(lambda event=event: self._node.transport.deliver(event))  # type: ignore[misc]

    def _drop_if_at_fault(self, act: Callable[[], None]) -> None:
        """Call `act`, which uses a member's data. If the member has broken the protocol, refuse it for a while."""
        try:
            act()
        except PeerAtFault as fault:
            self._network.drop(fault.member_id, str(fault))

    def close(self) -> None:
        """End all waiting calls, write everything to disk and close the store."""
        for proposal in self._arrivals.proposals:
            self._proposals.add(proposal)
        for request in self._arrivals.snapshot_requests:
            self._snapshots.add(request)
        for change in self._arrivals.changes:
            self._refuse_change(change)
        self._proposals.close()
        self._changes.close()
        self._snapshots.close()
        for read in self._arrivals.reads:
            self._node.reads.add(self._later(read))
        self._node.reads.close()
        self._log.close()
        self._run_completions()

    def _refuse_change(self, change: MemberChange | HandOver) -> None:
        """Answer a change or hand-over that has not begun, because this replica is closing."""
        if isinstance(change, HandOver):
            self._changes.hand_over(change)
        else:
            self._completions.append(lambda: change.done(LogUnavailable("this replica is closing")))

    def _accept_requests(self) -> None:
        for proposal in taken_from(self._arrivals.proposals):
            self._proposals.add(proposal)
        for read in taken_from(self._arrivals.reads):
            self._node.reads.add(self._later(read))
        for change in taken_from(self._arrivals.changes):
            if isinstance(change, HandOver):
                self._changes.hand_over(change)
            else:
                self._changes.add(change)
        for request in taken_from(self._arrivals.snapshot_requests):
            self._snapshots.add(request)
        takes = self._leader_reachable() and not self._changes.hands_over
        self._proposals.advance(leader_reachable=takes, now=self._clock())

    def _later(self, read: ConfirmedRead) -> ConfirmedRead:
        """The same read, whose caller gets the result after the next sync of the log."""
        done = read.done
        return ConfirmedRead(read.deadline, lambda index: self._completions.append(lambda: done(index)))

    def _release(self) -> None:
        self.durable_end = self._log.end()
        self._publish_roster()
        messages = self._node.transport.take_outbox()
        if messages:
            self._network.release(messages)
        self._status = self._observe()
        self._run_completions()

    def _run_completions(self) -> None:
        # Clears the list and keeps the object, because Proposals and others hold its `append`.
        completions = self._completions[:]
        self._completions.clear()
        for complete in completions:
            complete()

    def _leader_reachable(self) -> bool:
        leader = self._node.leader
        if leader is None:
            return False
        is_self = leader.id == self._settings.self_member.member_id
        return bool(is_self or self._node.transport.is_reachable(leader.id))

    def _commits_alone(self) -> bool:
        """Whether this leader is the only voter, and has entries to commit. Then no message causes the next step."""
        node = self._node
        waiting = node.commit_index < self._log.last_index
        return bool(waiting and not node.other_voters and node.is_leader)

    def _observe(self) -> ReplicationStatus:
        node, members = self._node, self.roster.members
        leader, leads = node.leader, node.is_leader
        term = node.term
        return ReplicationStatus(
            self_id=self._settings.self_member.member_id,
            leader_id=None if leader is None else leader.id,
            is_leader=leads,
            tenure=term if leads else 0,
            term=term,
            applied_index=node.last_applied,
            members=members,
            diverged_at=node.digests.diverged_at,
            doubts=node.doubts(),
            feature_level=self._state_machine.feature_level,
            highest_levels=node.known_levels(),
            commit_index=node.commit_index,
            last_index=self._log.last_index,
            lags=self._lags() if leads else {},
        )

    def _lags(self) -> dict[str, int]:
        """By member, the number of entries that it does not have yet, as this leader knows."""
        last = self._log.last_index
        return {peer.id: max(0, last - match) for peer, match in self._node.match_index.items()}

    def _publish_roster(self) -> None:
        """Publish the members that this node knows, if they have changed."""
        node, configurations = self._node, self._log.configurations
        applied = configurations.at(node.last_applied)
        current = configurations.current
        if self._roster_version == (current, applied, node.peers):
            return
        self._roster_version = (current, applied, node.peers)
        self.roster = MemberRoster(current.members, node.peers, frozenset(applied.retired))
        self._network.follow(self.roster)
