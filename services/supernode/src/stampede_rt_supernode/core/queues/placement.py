"""Where queues and mailboxes live, and what becomes of them when their host goes. Pure.

A queue whose host is lost waits, like a channel, until somebody opens it. Nobody opens a mailbox, so that gets another
live host in the very step that ends the lease, and those who send to it find it there.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.lookups import host_by_name
from stampede_rt_supernode.core.records import HostRecord, QueueRecord
from stampede_rt_supernode.core.tables import Tables


def choose_host(tables: Tables, queue: str, host_name: str, former: str | None = None) -> HostRecord:
    """The live host asked for; else the one that bears the `former` owner's name; else the one with the fewest channels
    and queues, the first by name of several. Raises InvalidName, HostNotFound, or Unavailable with reason NO_HOST."""
    if host_name:
        return host_by_name(tables, host_name)
    successor = tables.live_host_named(former) if former is not None else None
    least = successor or _least_loaded(tables)
    if least is None:
        raise Unavailable(
            f"there is no live host for {queue}; start one with `stampede host`, or wait for one",
            reason="NO_HOST",
            metadata={"queue": queue},
        )
    return least


def _least_loaded(tables: Tables) -> HostRecord | None:
    def load(host: HostRecord) -> int:
        return host.channels + tables.queues.count_at(host.host_id)

    return min(tables.live_hosts(), key=load, default=None)


def begun_anew(queue: QueueRecord, host: HostRecord, incarnation: int) -> QueueRecord:
    """`queue` at `host`, empty: under the next epoch and another incarnation, `incarnation` unless it had that."""
    if incarnation == queue.incarnation:
        incarnation = (incarnation + 1) % 2**64 or 1
    return replace(queue, host_id=host.host_id, epoch=queue.epoch + 1, incarnation=incarnation)


def renew_queues(tables: Tables, host: HostRecord, incarnation: int) -> None:
    """A host has started anew: what it held is gone, and its queues and mailboxes begin anew where they are."""
    for queue in tables.queues.at(host.host_id):
        tables.put_queue(begun_anew(queue, host, incarnation))


def rehouse_mailboxes(tables: Tables, host_id: bytes) -> None:
    """The lease of a host has ended: its mailboxes go to live hosts, if there are any, and are empty there."""
    for queue in tables.queues.at(host_id):
        host = _least_loaded(tables)
        if queue.mailbox_peer_id is not None and host is not None:
            # The incarnation is random at first, and counted on.
            tables.put_queue(begun_anew(queue, host, queue.incarnation))


def house_waiting_mailboxes(tables: Tables) -> None:
    """A live host is there again after there was none: the mailboxes of the lost ones need wait no longer."""
    lost = [host.host_id for host in tables.hosts.values() if not host.alive]
    for host_id in sorted(lost):
        rehouse_mailboxes(tables, host_id)
