"""The one interface between the directory and the log that replicates it.

Everything above this file sees bytes in, bytes out, and never the library below it, so that another
replicated log can take its place (paper, section 4.3: "standard consensus techniques").
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol


class StateMachine(Protocol):
    """The state machine that the log drives. Methods are called on the log's own thread, if nothing else is said; they
    neither raise nor block.

    Releases know commands up to a highest feature level. The state has a level, up to which all members know them.
    """

    @property
    def highest_level(self) -> int:
        """The highest feature level that this release knows, 1 or more. From any thread."""

    @property
    def feature_level(self) -> int:
        """The state's, 1 or more; it never falls. From any thread."""

    def takes(self, command: bytes) -> bool:
        """Whether the state's level allows the command in the log. From any thread."""

    def apply(self, index: int, command: bytes) -> bytes:
        """Apply the committed command at log position `index` (grows, may skip) and return its encoded result.

        Deterministic: no clock, no randomness. A command that makes no sense yields an encoded refusal. Raises
        ReleaseTooOld if the state comes to a feature level that this release does not know: nothing goes on then.
        """

    def digest(self) -> tuple[int, bytes]:
        """The last position applied, and a digest of what was done up to there: the same wherever the state is.

        Cheap: it is asked for with every command and every message. Empty: not known.
        """

    def adopt_digest(self, digest: bytes) -> None:
        """Go on from the leader's digest at the last position applied: the state's own is not known."""

    def begin_snapshot(self) -> Callable[[], bytes]:
        """Copy the whole state as of the last applied command, and return what encodes it.

        That is called once, on another thread, while commands go on being applied; the next one begins after it.
        """

    def prepare_restore(self, snapshot: bytes) -> Callable[[], None]:
        """Decode a snapshot of this or another replica, and return what replaces the whole state by it.

        The decoding may be done on another thread, while commands go on being applied; it may raise.
        """


@dataclass(frozen=True, kw_only=True, slots=True)
class Member:
    """One replica: its id (opaque, never reused) and the address of its gRPC port, `host:port`."""

    member_id: str
    address: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicationStatus:
    """The log at this moment, as a replica believes it to be; it may be stale.

    `tenure` is the term of the leadership this replica itself holds, 0 while it is not the leader. `members` may
    be committed or not yet. `removed`: the leader, or most of the others, say that this one was removed, for good;
    `has_lost_store`: that it was here before with another store, or lacks one; `has_old_store`: that its store lacks
    what it has promised. `refused_by`: which members say one of these or `too_old`, and their words.
    `other_cluster`: what one said that is of another cluster. `refused`: by id, why this one does not
    take the store with which another member came last. `diverged_at`: where this one's state was found to differ from
    that of most members; 0: nowhere. `doubts`: by id, where a member's state (this one's, or, at a leader, those of
    others) was found to differ from the leader's, while nobody knows what most hold. `feature_level` is the state's,
    `highest_levels` what each member has told of its release, this one included. `too_old`: what the leader, or most of
    the others, say of this one's release, which does not know the cluster's level. `retired`: ids that were members,
    and never come back.
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
    refused: Mapping[str, str] = field(default_factory=dict)
    feature_level: int = 1
    highest_levels: Mapping[str, int] = field(default_factory=dict)
    too_old: str = ""
    refused_by: Mapping[str, str] = field(default_factory=dict)
    retired: Collection[str] = ()

    @property
    def level_of_members(self) -> int:
        """The highest feature level that all members have told that they know; 0 as long as one has not told."""
        return min((self.highest_levels.get(member.member_id, 0) for member in self.members), default=0)


@dataclass(frozen=True, kw_only=True, slots=True)
class TakenSnapshot:
    """A snapshot on stable storage. `record` is opaque: `make_backup` makes a file of it, `restore_from` opens that."""

    log_index: int
    record: bytes


TOO_OLD = "is of a release that is too old"


def too_old(member_id: str, highest_level: int, level: int) -> str:
    """In one sentence, about a member or newcomer whose release does not know the level of the cluster."""
    return f"{member_id!r} {TOO_OLD}: it knows feature level {highest_level}, and the cluster is at level {level}"


class ReleaseTooOld(Exception):
    """The cluster is at a feature level that this release does not know: the member goes no further."""

    def __init__(self, highest_level: int, cluster_level: int) -> None:
        self.highest_level, self.cluster_level = highest_level, cluster_level
        super().__init__(
            f"this release knows feature level {highest_level}, and the cluster is at level {cluster_level}; start "
            "this supernode with the release of the others and the same data folder, and it goes on"
        )


class LogUnavailable(Exception):
    """No majority answered in time and the command was certainly not taken into the log: safe to try again."""


class NotLeading(Exception):
    """Only the leader changes the members, and this replica is not it."""


class ChangeUnderWay(Exception):
    """One member comes or goes at a time, and another one is just coming or going: try again in a while."""


class ChangeRefused(Exception):
    """The members cannot be changed in this way; the message says why and what to do."""


class TicketSpent(ChangeRefused):
    """The ticket has let another member in."""


class ReleaseOutdated(ChangeRefused):
    """The newcomer's release does not know the cluster's feature level."""


class Ambiguous(Exception):
    """The command may or may not be applied: try again with the same operation id, never report it as failed."""


class ReplicatedLog(Protocol):
    """A replica of the log, used from the asyncio loop that it was started on."""

    async def propose(self, command: bytes, *, timeout: float) -> bytes:
        """Replicate `command` (64 KiB at most) and return what `apply` gave for it, `timeout` seconds at most.

        Raises LogUnavailable or Ambiguous. Works on every replica: a follower passes it on to the leader.
        """

    async def confirm_read(self, *, timeout: float) -> int:
        """Return an applied index that holds every write acknowledged before this call began.

        After it, this replica's own state answers linearizably. Raises LogUnavailable.
        """

    async def add_member(self, member: Member, *, ticket: str = "", timeout: float) -> int:
        """Let a replica in that runs at `member.address` and waits to join; return the log position of the change.

        It is counted once it has caught up. Idempotent: an addition under way is waited for, and goes on after
        `timeout`. A `ticket` lets one member in. Raises NotLeading, ChangeUnderWay, ChangeRefused (TicketSpent if it
        has let another one in), LogUnavailable or Ambiguous.
        """

    async def remove_member(self, member_id: str, *, timeout: float) -> int:
        """Remove a member, or hand over to another leader if it is this one; return the log position of the change.

        Idempotent: who is no member is removed. Raises as `add_member`; NotLeading after a hand-over.
        """

    async def hand_over(self, *, timeout: float) -> bool:
        """Have another member lead, if this one does; whether this one does no more. Loses nothing if it fails."""

    async def take_snapshot(self, *, timeout: float) -> TakenSnapshot:
        """Have this replica write a snapshot of at least what it has applied by now; the last one, if nothing is new.

        Raises LogUnavailable; the snapshot may still be written.
        """

    def status(self) -> ReplicationStatus:
        """This replica's present view; never blocks."""

    async def close(self) -> None:
        """Stop taking part, with everything acknowledged on stable storage."""
