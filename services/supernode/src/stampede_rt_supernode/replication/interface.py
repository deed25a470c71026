"""The interface between the directory and the log that replicates it.

Commands, results and snapshots cross the interface as bytes. The directory does not depend on the library that
replicates them, so another library can replace PySyncObj (paper, section 4.3: "standard consensus techniques").
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from stampede_rt_runtime.metrics.families import Durations


class StateMachine(Protocol):
    """The state machine that the log drives.

    The log calls a method on its own thread, unless the method's text says otherwise. No method raises or blocks unless
    its text says so. A release knows the commands up to its highest feature level. The state has a feature level, too:
    all members know the commands up to that level.
    """

    @property
    def highest_level(self) -> int:
        """The highest feature level that this release knows, 1 or more. Callable on any thread."""

    @property
    def feature_level(self) -> int:
        """The state's feature level, 1 or more. It never falls. Callable on any thread."""

    def takes(self, command: bytes) -> bool:
        """Whether the state's feature level allows this command in the log. Callable on any thread."""

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply the committed command at log position `index`, and return its encoded result.

        `index` grows from call to call, perhaps with gaps. Deterministic: no clock, no randomness. An invalid command
        yields an encoded refusal. Raises ReleaseTooOld if the state reaches a feature level that this release does not
        know. Then the log stops.
        """

    def digest(self) -> tuple[int, bytes]:
        """The last applied position, and a digest of all results up to there. Equal states have equal digests.

        The digest is empty if it is unknown. The call must be cheap, because the log makes it after every command, and
        whenever it sends entries or heartbeats.
        """

    def adopt_digest(self, digest: bytes) -> None:
        """Use the leader's digest at the last applied position as this state's digest, which is unknown."""

    def begin_snapshot(self) -> Callable[[], bytes]:
        """Copy the whole state as of the last applied command. Returns a function that encodes the copy.

        The log calls that function once, on another thread, while it applies further commands. The log begins the next
        snapshot only when the function has returned.
        """

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        """Decode a snapshot of this or another replica. Returns a function that replaces the state by the snapshot.

        The log may call this method on another thread, while it applies further commands. It calls the returned
        function on its own thread. Raises ReleaseTooOld if this release does not know the snapshot's feature level, and
        any other error if the snapshot is unreadable.
        """


@dataclass(frozen=True, kw_only=True, slots=True)
class Member:
    """One replica: its id (opaque, never reused) and the address of its gRPC port, `host:port`."""

    member_id: str
    address: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicationStatus:
    """One replica's present view of the log, which may be out of date.

    - `tenure`: the term in which this replica leads, 0 while it does not lead.
    - `members`: the members by the newest configuration in the log, committed or not.
    - `removed`: the leader, or most of the others, say that this member was removed from the cluster.
    - `has_lost_store`: the leader, or most of the others, say that this member had another store before, or lacks one.
    - `has_old_store`: the leader, or most of the others, say that this member's store is an older copy.
    - `refusing_members`: the members that refuse this member, for the reason of `removed`, `has_lost_store`,
      `has_old_store` or `release_refusal`. By id: the words of the refusal. The refusal may be unconfirmed.
    - `other_cluster`: the words of a member of another cluster; empty if there was none.
    - `refused_members`: the members that this replica refuses because of their stores. By id: the reason.
    - `diverged_at`: the position at which this replica's state was found to differ from the state of most members; 0 if
      it was not.
    - `doubts`: by id, the position at which the states of a member and of the leader were found to differ. It is not
      known which of the two states most members have. A follower lists only itself, a leader lists the others.
    - `disk_silent_seconds`: how long this replica has waited for its disk; 0 if that is 3 s or less.
    - `feature_level`: the feature level of the state.
    - `highest_levels`: by id, the highest level that the release of each member knows, by the member's own report. Also
      for this member.
    - `release_refusal`: the words by which the leader, or most others, say that this release does not know the
      cluster's feature level; empty if they do not say it.
    - `former_ids`: the ids of removed members. No later member may have such an id.
    - `commit_index`, `last_index`: the positions of the last committed entry that this replica knows of, and of the
      last entry in its log.
    - `lags`: if this replica leads, by id the number of entries that each other member does not have yet.
    """

    self_id: str
    leader_id: str | None
    is_leader: bool
    tenure: int
    term: int
    applied_index: int
    members: Sequence[Member]
    removed: bool = False
    has_lost_store: bool = False
    has_old_store: bool = False
    other_cluster: str = ""
    diverged_at: int = 0
    doubts: Mapping[str, int] = field(default_factory=dict)
    disk_silent_seconds: float = 0.0
    refused_members: Mapping[str, str] = field(default_factory=dict)
    feature_level: int = 1
    highest_levels: Mapping[str, int] = field(default_factory=dict)
    release_refusal: str = ""
    refusing_members: Mapping[str, str] = field(default_factory=dict)
    former_ids: Collection[str] = ()
    commit_index: int = 0
    last_index: int = 0
    lags: Mapping[str, int] = field(default_factory=dict)

    @property
    def level_of_members(self) -> int:
        """The highest feature level that all members know; 0 as long as a member has not reported its level."""
        return min((self.highest_levels.get(member.member_id, 0) for member in self.members), default=0)


@dataclass(frozen=True, kw_only=True, slots=True)
class TakenSnapshot:
    """A snapshot on stable storage. `log_index` is the last log position that it covers.

    `record` is opaque. `make_backup` makes a backup file of it, and `restore_from` reads the file.
    """

    log_index: int
    record: bytes


# The words in every refusal of a release that does not know the cluster's feature level.
TOO_OLD = "is of a release that is too old"


def too_old(member_id: str, highest_level: int, level: int) -> str:
    """The error text, as one sentence, for a member or newcomer whose release does not know the cluster's level."""
    return f"{member_id!r} {TOO_OLD}: it knows feature level {highest_level}, and the cluster is at level {level}"


class ReleaseTooOld(Exception):
    """The cluster is at a feature level that this release does not know. The member stops applying commands."""

    def __init__(self, highest_level: int, cluster_level: int) -> None:
        self.highest_level, self.cluster_level = highest_level, cluster_level
        super().__init__(
            f"this release knows feature level {highest_level}, and the cluster is at level {cluster_level}; start "
            "this supernode with the release of the others and the same data folder; it then catches up with them"
        )


class LogUnavailable(Exception):
    """The log cannot serve the call now: it has no leader or no majority, too many calls wait, or it is closed.

    A proposed command certainly takes no effect. Safe to try again.
    """


class NotLeading(Exception):
    """Only the leader changes the members, and this replica does not lead."""


class ChangeUnderWay(Exception):
    """The leader cannot change the members now, for example because another change is under way. Try again later."""


class ChangeRefused(Exception):
    """The members cannot be changed in this way. The message gives the reason and the way out."""


class TicketSpent(ChangeRefused):
    """The ticket has let in a member already. Each ticket lets in only one."""


class ReleaseOutdated(ChangeRefused):
    """The newcomer's release does not know the cluster's feature level."""


class OutcomeUnknown(Exception):
    """The command, or the change of the members, may or may not take effect. Do not report that it has failed.

    Propose the command again with the same operation id, or ask for the same change again.
    """


class ReplicatedLog(Protocol):
    """A replica of the log, used from the asyncio loop on which it was started."""

    async def propose(self, command: bytes, *, timeout: float) -> bytes:
        """Replicate `command` (64 KiB at most) and return the result of `apply`. Waits `timeout` seconds at most.

        Works on every replica: a follower passes the command on to the leader. Raises LogUnavailable or OutcomeUnknown,
        and ValueError for a larger command.
        """

    async def confirm_read(self, *, timeout: float) -> int:
        """Return an applied index that includes every write acknowledged before this call began.

        Later reads of this replica's own state are linearizable. Waits `timeout` seconds at most. Raises
        LogUnavailable.
        """

    async def add_member(self, member: Member, *, ticket: str = "", timeout: float) -> int:
        """Add a replica that runs at `member.address` and waits to join. Returns the log position of the change.

        If the replica is a member already, returns the last applied position. The replica becomes a member as soon as
        it has caught up. Idempotent: a repeated call waits for the addition under way, which continues after `timeout`.
        A `ticket` lets in one member. Raises NotLeading, ChangeUnderWay, ChangeRefused (TicketSpent if the ticket is
        used up, ReleaseOutdated if the newcomer's release is too old), LogUnavailable or OutcomeUnknown.
        """

    async def remove_member(self, member_id: str, *, timeout: float) -> int:
        """Remove a member. If this replica is that member, hand over to another leader. Returns the log position of the
        change.

        Idempotent: the removal of a non-member succeeds, and returns the last applied position. Raises the errors of
        `add_member`. After a hand-over it raises NotLeading; then ask the new leader for the removal.
        """

    async def hand_over(self, *, timeout: float) -> bool:
        """Have another member lead, if this member leads.

        Returns True if this member does not lead afterwards. A failure loses nothing. Raises LogUnavailable if this
        replica is closed, or too many changes wait.
        """

    async def take_snapshot(self, *, timeout: float) -> TakenSnapshot:
        """Write a snapshot that covers all entries applied so far. If the last snapshot covers them, return that one.

        Raises LogUnavailable. Even then the log may still write the snapshot.
        """

    def status(self) -> ReplicationStatus:
        """This replica's present view. Never blocks."""

    def write_times(self) -> Durations:
        """The durations of the writes to the store, each with its wait for the disk. Never blocks."""

    async def close(self) -> None:
        """Stop taking part. Afterwards the whole log is on stable storage."""
