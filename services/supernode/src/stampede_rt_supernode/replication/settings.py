"""The settings of a replica. They are checked when they are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stampede_rt_supernode.replication.interface import Member

COMMAND_BYTES_MAX = 64 * 1024
# The version of the protocol between members. Members with different versions refuse each other.
PROTOCOL_VERSION = 2
# The most bytes of a snapshot that one message carries.
SNAPSHOT_PIECE_BYTES_MAX = 1 << 20

# The settings that must be more than 0.
_POSITIVE = (
    "proposals_max",
    "reads_max",
    "inbox_items_max",
    "inbox_bytes_max",
    "link_queue_bytes_max",
    "kept_log_bytes_max",
    "snapshot_every_seconds",
    "snapshot_piece_bytes",
)


@dataclass(frozen=True, kw_only=True, slots=True)
class RaftTiming:
    """The periods of the log. With the defaults the log serves again within 5 s after the loss of a leader."""

    # The longest time between two steps of the log's thread.
    tick_seconds: float = 0.03
    # The longest time between two steps of a leader without other members, while nothing waits.
    idle_seconds: float = 0.5
    heartbeat_seconds: float = 0.1
    election_timeout_min_seconds: float = 1.0
    election_timeout_max_seconds: float = 2.0
    # A leader that no majority has answered for this time stops leading.
    leader_fallback_seconds: float = 2.0
    # The longest pause before a link opens its stream again.
    reconnect_seconds: float = 0.5
    # A link ends a stream on which the peer has not answered for this time.
    link_silence_seconds: float = 3.0
    # A follower repeats its request for the position of a read after this time.
    read_retry_seconds: float = 0.5

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.election_timeout_min_seconds <= 3 * self.heartbeat_seconds:
            raise ValueError(
                "election_timeout_min_seconds must be more than three heartbeats, or leaders would change without need"
            )
        if self.election_timeout_max_seconds <= self.election_timeout_min_seconds:
            raise ValueError("election_timeout_max_seconds must be more than election_timeout_min_seconds")


@dataclass(frozen=True, kw_only=True, slots=True)
class ReplicationSettings:
    """One replica of the log.

    `initial_members` holds every member, this one included. With `joining` it holds the present members without this
    replica, which they will add. As soon as the log has a configuration, that configuration counts instead. `data_dir`
    is the folder of this replica's store; None keeps everything in memory, for development. `create` allows a new store
    in a folder without one. Use False if a store must exist, because a member that lost its disk must come back under a
    new id. The members of one cluster have the same `cluster_id`, and refuse callers with another id. At most
    `proposals_max` commands and `reads_max` reads wait. The log takes a snapshot when it has more than
    `snapshot_every_entries` entries, or when the last snapshot is more than `snapshot_every_seconds` old. A leader
    sends a snapshot in pieces of `snapshot_piece_bytes`. `inbox_items_max` messages and `inbox_bytes_max` bytes of each
    other member may wait for this replica, and `link_queue_bytes_max` bytes may wait on the link to each member. After
    a snapshot has replaced log entries, a leader keeps the newest `kept_log_bytes_max` bytes of them for slow members.
    """

    self_member: Member
    initial_members: Sequence[Member]
    data_dir: Path | None = None
    create: bool = True
    joining: bool = False
    cluster_id: str = ""
    timing: RaftTiming = field(default_factory=RaftTiming)
    proposals_max: int = 1000
    reads_max: int = 10_000
    snapshot_every_entries: int = 5000
    snapshot_every_seconds: float = 300.0
    snapshot_piece_bytes: int = 256 * 1024
    inbox_items_max: int = 20_000
    inbox_bytes_max: int = 64 << 20
    link_queue_bytes_max: int = 32 << 20
    kept_log_bytes_max: int = 64 << 20

    def __post_init__(self) -> None:
        ids = [member.member_id for member in self.initial_members]
        if "" in ids:
            raise ValueError("a member id is empty: give every member an id of its own")
        if len(set(ids)) != len(ids):
            raise ValueError(f"two members have the same id: {sorted(ids)}")
        if self.joining and (self.self_member.member_id in ids or not ids):
            raise ValueError(
                f"{self.self_member.member_id!r} is to join {sorted(ids)}: name the present members, not the new one"
            )
        if not self.joining and self.self_member not in self.initial_members:
            raise ValueError(
                f"this member, {self.self_member.member_id!r} at {self.self_member.address!r}, is not among the "
                f"members {sorted(ids)}: list every member, this one included, with the same address"
            )
        for name in _POSITIVE:
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name)}")
        if self.snapshot_piece_bytes > SNAPSHOT_PIECE_BYTES_MAX:
            raise ValueError(f"snapshot_piece_bytes must be at most {SNAPSHOT_PIECE_BYTES_MAX}")
        if self.snapshot_every_entries < 2:
            raise ValueError(f"snapshot_every_entries must be 2 or more, not {self.snapshot_every_entries}")
