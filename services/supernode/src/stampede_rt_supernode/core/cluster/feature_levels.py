"""Feature levels: which commands a release knows, and which of them a cluster of several releases may use. Pure.

While members are upgraded one by one, releases differ. A command that one of them does not know would be refused by
that member alone, and the states would differ from then on. So each kind of command needs a level, which is in its row
of the command table. Each release knows all kinds up to its highest level, and the replicated state holds the cluster's
level. The leader raises it once all members know a higher one. It never falls. No replica does a command above it.

A release that adds a kind of command, or changes what one does, adds one to HIGHEST_LEVEL. A new kind gets that level.
A changed one looks at the level of the state, and does what it did before as long as that is lower.
"""

from __future__ import annotations

# The highest level that this release knows. 2: rules of access, client tokens and quotas.
HIGHEST_LEVEL = 2
# Where a cluster is that was founded before there were levels.
FIRST_LEVEL = 1
# From here on replicas keep who owns peers, and who made channels, queues and groups.
OWNERS_LEVEL = 2


def may_be_used(needed: int, cluster_level: int) -> bool:
    """Whether a command that needs that level may enter the log, and be done, in a cluster at `cluster_level`."""
    return needed <= cluster_level
