"""Decides which of several processes of one peer or host is the newest. Pure.

The network, or a supernode without a leader, may delay a registration for seconds. Meanwhile its process may have been
killed and started again. No clock shows which of the two registrations is older. So each process has a number, its
registration epoch. A process registers with a number above the number that it finds in the directory. The directory
refuses a number that another process has already reached. So, after the successor of a process has registered, the
directory refuses a delayed registration of that process.
"""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import InvalidArgument, StaleRegistration
from stampede_rt_supernode.core.hosts.commands import RegisterHost
from stampede_rt_supernode.core.peers.commands import RegisterPeer
from stampede_rt_supernode.core.records import HostRecord, PeerRecord

EPOCH_MAX = 2**63 - 1


def check_registration_epoch(operation: RegisterHost | RegisterPeer) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    if not 0 <= operation.registration_epoch <= EPOCH_MAX:
        text = (
            f"registration_epoch is {operation.registration_epoch}; take the epoch after the last one that was reached"
        )
        raise InvalidArgument(text, metadata={"field": "registration_epoch"})


def next_epoch(operation: RegisterHost | RegisterPeer, registrations: Iterable[HostRecord | PeerRecord | None]) -> int:
    """The registration epoch that the process gets.

    `registrations`: the registrations of the same peer or host, alive or ended, perhaps of this same process; None
    stands for no registration. Raises StaleRegistration if another process has reached the operation's epoch.
    """
    epoch = operation.registration_epoch
    others = []
    for before in registrations:
        if before is not None and before.boot_incarnation == operation.boot_incarnation:
            # This same process is registered. `operation` may be one of its earlier requests, with a lower epoch.
            epoch = max(epoch, before.registration_epoch)
        elif before is not None:
            others.append(before)
    highest = max(others, key=lambda one: one.registration_epoch, default=None)
    if highest is not None and highest.registration_epoch >= epoch:
        raise _stale(operation, highest, alive=any(one.alive for one in others))
    return epoch


def _stale(
    operation: RegisterHost | RegisterPeer, before: HostRecord | PeerRecord, *, alive: bool
) -> StaleRegistration:
    kind = "host" if isinstance(operation, RegisterHost) else "peer"
    shown = operation.name or before.holder_id.hex()
    return StaleRegistration(
        f"another process of {kind} {shown} has registered with epoch {before.registration_epoch}, and this request "
        f"brings {operation.registration_epoch}; a newer process registers with epoch {before.registration_epoch + 1}; "
        "make sure that no two running processes share one identity",
        metadata={
            kind: shown,
            "registration_epoch": str(before.registration_epoch),
            "alive": "true" if alive else "false",
        },
    )
