"""Feature levels: the commands that a release knows, and the commands that a cluster of several releases may use. Pure.

Members are upgraded one by one, so their releases differ for a while. If one member did not know a command, only that
member would refuse it, and the states would differ from then on. So each kind of command needs a level, which is in its
row of the command table. Each release knows all kinds up to its highest level. The replicated state holds the cluster's
level. The leader raises the cluster's level as soon as all members know a higher level. The cluster's level never
falls. Every replica refuses a command that needs a higher level than the cluster's.

A release that adds or changes a kind of command increases HIGHEST_LEVEL by one. A new kind needs that level. A changed
kind checks the level of the state, and has its former effect while that level is lower.
"""

from __future__ import annotations

# The highest level that this release knows. 2: rules of access, client tokens and quotas. 3: quotas of groups and of
# peers. 4: loads of hosts, channels that open beside others, the names of deleted groups in answers, the tenure of the
# leader that raises a level, moves of channels, recorded channels, replicas of queues, and replicas for which no put
# waits.
HIGHEST_LEVEL = 4
# The level of a cluster that was founded before there were levels.
FIRST_LEVEL = 1
# From this level on replicas keep the owners of peers, and the creators of channels, queues and groups.
OWNERS_LEVEL = 2
# From this level on replicas limit the groups and peers of each caller, and the memory for the answers to it.
GROUPS_AND_PEERS_LEVEL = 3
# From this level on replicas keep the loads of hosts, and place channels and queues by them.
LOADS_LEVEL = 4
# From this level on the answers to deletions name the groups that are gone.
FREED_GROUPS_LEVEL = 4
# From this level on channels can move.
MOVES_LEVEL = 4
# From this level on channels may have replicas for which no put waits.
LAGGING_REPLICAS_LEVEL = 4
# From this level on the policies of channels may have archives.
ARCHIVE_LEVEL = 4
# From this level on queues and mailboxes may have replicas.
QUEUE_REPLICAS_LEVEL = 4
# From this level on replicas keep the log position at which each copy was added, and compare the facts that a caller
# knows: the epoch of a removal, the log position of a copy, and whether puts wait for a new replica.
CALLERS_FACTS_LEVEL = 4


def may_be_used(needed: int, cluster_level: int) -> bool:
    """Whether a cluster at `cluster_level` may use a command that needs the level `needed`."""
    return needed <= cluster_level
