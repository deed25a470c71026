"""Whether a registration comes too late: its process may have been killed and started again since. Pure.

A supernode holds a registration until there is a leader, for seconds. Done after that of the newer process, it would
take the name, or the lease, from the one that lives and give it to one that does not.
"""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.hosts.commands import RegisterHost
from stampede_rt_supernode.core.peers.commands import RegisterPeer
from stampede_rt_supernode.core.records import HostRecord, PeerRecord


def check_in_time(
    operation: RegisterHost | RegisterPeer, former: Iterable[HostRecord | PeerRecord | None], as_of_index: int
) -> None:
    """Raises Unavailable with reason AMBIGUOUS if a later process has registered since the request was made.

    `former`: the records that it would replace. `as_of_index`: how far the state reached when the request came; 0 if
    the request does not say so.
    """
    for before in former:
        if before is None or before.boot_incarnation == operation.boot_incarnation:
            continue
        if 0 < as_of_index < before.registered_index:
            raise Unavailable(
                f"{operation.name or 'the peer'} has registered from another process while this request was under way; "
                "if this process is the newer one, send the request again",
                reason="AMBIGUOUS",
            )
