"""The replicated log: commands in, results out, in the same order on every member.

`await open_replicated_log(settings, state_machine, dial, server)` gives a ReplicatedLog (see interface.py). The log
runs PySyncObj on a thread of its own. This package corrects the faults of that library, and no other package imports
the library. Order of use:

1. Bind a `grpc.aio` server, so that the address of this member is known. Do not start it yet.
2. Open the log: it loads its state and registers its service with the server.
3. Register the directory's own services with the same server, and start it.

At the end, close the log before the server stops.
"""

from stampede_rt_supernode.replication.interface import (
    ChangeRefused,
    ChangeUnderWay,
    LogUnavailable,
    Member,
    NotLeading,
    OutcomeUnknown,
    ReleaseOutdated,
    ReleaseTooOld,
    ReplicatedLog,
    ReplicationStatus,
    StateMachine,
    TakenSnapshot,
    TicketSpent,
)
from stampede_rt_supernode.replication.library.pinned_copy import LibraryMismatch
from stampede_rt_supernode.replication.network.peer_link import CHANNEL_OPTIONS
from stampede_rt_supernode.replication.replicated_log import open_replicated_log
from stampede_rt_supernode.replication.settings import COMMAND_BYTES_MAX, RaftTiming, ReplicationSettings
from stampede_rt_supernode.replication.storage.backups import Backup, BackupHeader, make_backup
from stampede_rt_supernode.replication.storage.restoring import restore_from
from stampede_rt_supernode.replication.storage.sqlite_store import holds_store, read_identity
from stampede_rt_supernode.replication.storage.store import StoreDamaged, StoreRefused

__all__ = [
    "CHANNEL_OPTIONS",
    "COMMAND_BYTES_MAX",
    "Backup",
    "BackupHeader",
    "ChangeRefused",
    "ChangeUnderWay",
    "LibraryMismatch",
    "LogUnavailable",
    "Member",
    "NotLeading",
    "OutcomeUnknown",
    "RaftTiming",
    "ReleaseOutdated",
    "ReleaseTooOld",
    "ReplicatedLog",
    "ReplicationSettings",
    "ReplicationStatus",
    "StateMachine",
    "StoreDamaged",
    "StoreRefused",
    "TakenSnapshot",
    "TicketSpent",
    "holds_store",
    "make_backup",
    "open_replicated_log",
    "read_identity",
    "restore_from",
]
