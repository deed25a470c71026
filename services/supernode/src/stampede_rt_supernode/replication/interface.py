"""The only interface between the directory and the log that replicates it.

The code above this file sees bytes in and bytes out, and never the library below it. So another library can replace
this one (paper, section 4.3: "standard consensus techniques").
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol


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

        The digest is empty if it is unknown. The call must be cheap, because the log makes it for every command and
        every message.
        """

    def adopt_digest(self, digest: bytes) -> None:
        """Take over the leader's digest at the last applied position, because the state's own is unknown."""

    def begin_snapshot(self) -> Callable[[], bytes]:
        """Copy the whole state as of the last applied command. Returns a function that encodes the copy.

        The log calls that function once, on another thread, while it applies further commands. The log begins the next
        snapshot only when the function has returned.
        """

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        """Decode a snapshot of this or another replica. Returns a function that puts it in the place of the state.

        May run on another thread, while the log applies further commands. May raise.
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
    - `removed`: the leader, or most of the others, say that this member was removed for good.
    - `has_lost_store`: the leader, or most of the others, say that this member had another store before, or lacks one.
    - `has_old_store`: the leader, or most of the others, say that this member's store is an older copy.
    - `refused_by`: by id, the words of each member that says one of these three things or `too_old`.
    - `other_cluster`: the words of a member of another cluster.
    - `refused`: by id, the reason why this replica does not accept the latest store of another member.
    - `diverged_at`: the position at which this replica's state was found to differ from that of most members;
      0 if it was not.
    - `doubts`: by id, the position at which a member's state was found to differ from the leader's, while nobody knows
      the state of most. A follower lists only itself, a leader the others.
    - `disk_silent_seconds`: how long this replica's disk has not answered, if that is too long; 0 otherwise.
    - `feature_level`: the feature level of the state.
    - `highest_levels`: by id, the highest level of each member's release, this one included, as it reported.
    - `too_old`: the words of the leader, or of most others, that this release does not know the cluster's level.
    - `retired`: ids of former members, which are never used again.
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
    refused: Mapping[str, str] = field(default_factory=dict)
    feature_level: int = 1
    highest_levels: Mapping[str, int] = field(default_factory=dict)
    too_old: str = ""
    refused_by: Mapping[str, str] = field(default_factory=dict)
    retired: Collection[str] = ()

    @property
    def level_of_members(self) -> int:
        """The highest feature level that all members know; 0 as long as a member has not reported its own."""
        return min((self.highest_levels.get(member.member_id, 0) for member in self.members), default=0)


@dataclass(frozen=True, kw_only=True, slots=True)
class TakenSnapshot:
    """A snapshot on stable storage.

    `record` is opaque. `make_backup` writes it to a file, and `restore_from` opens the file.
    """

    log_index: int
    record: bytes


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
    """No majority answered in time, and the command is certainly not in the log. Safe to try again."""


class NotLeading(Exception):
    """Only the leader changes the members, and this replica does not lead."""


class ChangeUnderWay(Exception):
    """Another member is being added or removed, and only one change runs at a time. Try again later."""


class ChangeRefused(Exception):
    """The members cannot be changed in this way. The message gives the reason and the way out."""


class TicketSpent(ChangeRefused):
    """The ticket has let in another member."""


class ReleaseOutdated(ChangeRefused):
    """The newcomer's release does not know the cluster's feature level."""


class Ambiguous(Exception):
    """The command may or may not be applied. Try again with the same operation id, and never report it as failed."""


class ReplicatedLog(Protocol):
    """A replica of the log, used from the asyncio loop on which it was started."""

    async def propose(self, command: bytes, *, timeout: float) -> bytes:
        """Replicate `command` (64 KiB at most) and return the result of `apply`. Waits `timeout` seconds at most.

        Raises LogUnavailable or Ambiguous. Works on every replica: a follower passes the command on to the leader.
        """

    async def confirm_read(self, *, timeout: float) -> int:
        """Return an applied index that includes every write acknowledged before this call began.

        After it, reads of this replica's own state are linearizable. Raises LogUnavailable.
        """

    async def add_member(self, member: Member, *, ticket: str = "", timeout: float) -> int:
        """Add a replica that runs at `member.address` and waits to join. Returns the log position of the change.

        The replica becomes a member once it has caught up. Idempotent: a repeated call waits for the addition under
        way, which continues after `timeout`. A `ticket` lets in one member. Raises NotLeading, ChangeUnderWay,
        ChangeRefused (TicketSpent if the ticket has let in another member), LogUnavailable or Ambiguous.
        """

    async def remove_member(self, member_id: str, *, timeout: float) -> int:
        """Remove a member. If this replica is that member, hand over to another leader. Returns the log position of the
        change.

        Idempotent: the removal of a non-member succeeds. Raises the errors of `add_member`. After a hand-over it raises
        NotLeading; then ask the new leader for the removal.
        """

    async def hand_over(self, *, timeout: float) -> bool:
        """Have another member lead, if this one leads.

        Returns True if this member does not lead afterwards. A failure loses nothing.
        """

    async def take_snapshot(self, *, timeout: float) -> TakenSnapshot:
        """Write a snapshot of at least the present applied state. Returns the last snapshot if nothing is new.

        Raises LogUnavailable; the snapshot may still be written.
        """

    def status(self) -> ReplicationStatus:
        """This replica's present view. Never blocks."""

    async def close(self) -> None:
        """Stop taking part. All acknowledged entries are on stable storage."""
