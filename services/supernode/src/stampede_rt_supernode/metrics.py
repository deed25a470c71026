"""The metrics of a supernode, besides the metrics that every service has."""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_runtime.metrics.families import AnyFamily, Family, Metric, counter, gauge, histogram
from stampede_rt_runtime.metrics.service_metrics import of_clocks
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.joining.probe import Probe
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.replication.interface import ReplicatedLog, ReplicationStatus

TERM = gauge("stampede_raft_term", "The present Raft term; it grows with each election.")
IS_LEADER = gauge("stampede_raft_is_leader", "1 if this supernode leads, else 0.")
HAS_LEADER = gauge("stampede_raft_has_leader", "1 if this supernode knows a leader, else 0.")
LEADER = gauge("stampede_raft_leader_info", "The leader that this supernode knows; the value is always 1.", "leader")
MEMBERS = gauge("stampede_raft_members", "The members of the cluster, this supernode included.")
MEMBERS_SERVING = gauge(
    "stampede_raft_members_serving", "The members that can serve, as this supernode finds them, itself included."
)
APPLIED = counter(
    "stampede_raft_applied_entries_total", "The position of the last entry that the directory has applied."
)
COMMITTED = counter("stampede_raft_committed_entries_total", "The position of the last entry known to be committed.")
COMMIT_LAG = gauge(
    "stampede_raft_commit_lag_entries",
    "Entries in this supernode's log that are not committed yet, as far as it knows.",
)
APPLY_LAG = gauge("stampede_raft_apply_lag_entries", "Committed entries that the directory has not applied yet.")
MEMBER_LAG = gauge(
    "stampede_raft_member_lag_entries",
    "Entries that another member does not have yet; only the leader reports them.",
    "member",
)
WRITES = histogram(
    "stampede_raft_write_seconds", "How long a write of the log took, with the wait until the disk has it (fsync)."
)
DISK_SILENT = gauge(
    "stampede_raft_disk_silent_seconds",
    "How long the disk of the data folder has not answered; 0 for up to 3 s without an answer.",
)
DIVERGED = gauge("stampede_raft_diverged", "1 if this supernode's directory differs from that of most members, else 0.")
FEATURE_LEVEL = gauge("stampede_feature_level", "The cluster's feature level, as this supernode knows it.")

DIRECTORY_HOSTS = gauge("stampede_directory_hosts", "Hosts: live, or lost while they owned something.", "state")
DIRECTORY_CHANNELS = gauge("stampede_directory_channels", "Channels in the directory.")
DIRECTORY_QUEUES = gauge("stampede_directory_queues", "Queues and mailboxes in the directory.")
DIRECTORY_GROUPS = gauge("stampede_directory_groups", "Groups in the directory.")
DIRECTORY_PEERS = gauge("stampede_directory_peers", "Live peers in the directory.")

METRICS: tuple[Metric, ...] = tuple(one for one in [*globals().values()] if isinstance(one, Metric))


class SupernodeMetrics:
    """The metrics of one supernode."""

    def __init__(self, log: ReplicatedLog, replica: DirectoryReplica, probe: Probe) -> None:
        self._log = log
        self._replica = replica
        self._probe = probe

    async def collect(self) -> list[AnyFamily]:
        """All metrics. Their number is bounded by the number of members."""
        status = self._log.status()
        families: list[AnyFamily] = [*_of_log(status)]
        serving = sum(self._probe.serves(member.member_id) for member in status.members)
        own = status.leader_id is not None and not status.diverged_at
        families.append(MEMBERS_SERVING.of(serving + own))
        families.append(self._log.write_times().family(WRITES))
        families += self._replica.read(lambda directory: [*_of_directory(directory)])
        families += of_clocks(self._probe.clocks())
        return families


def _of_log(status: ReplicationStatus) -> Iterator[Family]:
    yield TERM.of(status.term)
    yield IS_LEADER.of(status.is_leader)
    yield HAS_LEADER.of(status.leader_id is not None)
    yield LEADER.family([((status.leader_id,), 1)] if status.leader_id is not None else [])
    yield MEMBERS.of(len(status.members))
    yield APPLIED.of(status.applied_index)
    yield COMMITTED.of(status.commit_index)
    yield COMMIT_LAG.of(max(0, status.last_index - status.commit_index))
    yield APPLY_LAG.of(max(0, status.commit_index - status.applied_index))
    yield MEMBER_LAG.family(((member,), lag) for member, lag in sorted(status.lags.items()))
    yield DISK_SILENT.of(status.disk_silent_seconds)
    yield DIVERGED.of(bool(status.diverged_at))
    yield FEATURE_LEVEL.of(status.feature_level)


def _of_directory(directory: Directory) -> Iterator[Family]:
    tables = directory.tables
    live, lost = len(tables.host_ids), len(tables.lost)
    yield DIRECTORY_HOSTS.family([(("live",), live), (("lost",), lost)])
    yield DIRECTORY_CHANNELS.of(len(tables.channels))
    yield DIRECTORY_QUEUES.of(len(tables.queues))
    yield DIRECTORY_GROUPS.of(len(tables.groups))
    yield DIRECTORY_PEERS.of(tables.peers.live_count)
