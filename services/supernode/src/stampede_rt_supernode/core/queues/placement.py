"""Chooses the hosts of queues and mailboxes, and applies the loss of a host to them. Pure.

If the host of a queue is lost, the queue gets a new host when a client next opens it, like a channel. No client opens a
mailbox. So the step that ends the host's lease moves its mailboxes to other live hosts, where senders find them.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.hosts.placement import least_loaded
from stampede_rt_supernode.core.lookups import host_by_name
from stampede_rt_supernode.core.records import HostRecord, QueueRecord
from stampede_rt_supernode.core.replicas.transitions import copies_after_owner_change, store
from stampede_rt_supernode.core.tables import Tables


def choose_host(tables: Tables, queue: str, host_name: str, former: str | None = None) -> HostRecord:
    """The host for a new queue, or for a queue whose owner is not alive.

    The function takes the live host `host_name`, if the caller names one. Otherwise it takes the live host with the
    name of the `former` owner. Otherwise it takes the least loaded live host; among equals the host with the fewest
    channels and queues. `queue`: the queue as error texts name it. Raises InvalidName, HostNotFound, or Unavailable
    with reason NO_HOST.
    """
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
    def count(host: HostRecord) -> int:
        return host.channels + tables.queues.count_at(host.host_id)

    return least_loaded(tables, tables.live_hosts(), count)


def with_new_incarnation(queue: QueueRecord, host: HostRecord, incarnation: int) -> QueueRecord:
    """`queue` at `host`, empty, with the next epoch and a new incarnation.

    The new incarnation is `incarnation`, or the next number if the queue has that incarnation already.
    """
    if incarnation == queue.incarnation:
        incarnation = (incarnation + 1) % 2**64 or 1
    return replace(queue, host_id=host.host_id, epoch=queue.epoch + 1, incarnation=incarnation)


def reset_queues(tables: Tables, host: HostRecord, incarnation: int) -> None:
    """Give the queues and mailboxes of a host a new incarnation there, because its restart has lost their messages."""
    for queue in tables.queues.at(host.host_id):
        give_queue(tables, queue, with_new_incarnation(queue, host, incarnation))


def give_queue(tables: Tables, before: QueueRecord, after: QueueRecord) -> None:
    """Replace a queue's record by `after`. If its owner or incarnation differs, its copies follow."""
    if before.epoch == after.epoch:
        tables.put_queue(after)
        return
    store(tables, after, copies_after_owner_change(tables, before, after))


def move_mailboxes(tables: Tables, host_id: bytes) -> None:
    """Move the mailboxes of a host whose lease has ended to live hosts, if there are any.

    The messages in the mailboxes are lost.
    """
    for queue in tables.queues.at(host_id):
        host = _least_loaded(tables)
        if queue.mailbox_peer_id is not None and host is not None:
            # The first incarnation of a mailbox is random; later ones count up.
            give_queue(tables, queue, with_new_incarnation(queue, host, queue.incarnation))


def move_waiting_mailboxes(tables: Tables) -> None:
    """Move the mailboxes whose hosts are not alive to a live host.

    Called when a host registers after a time without live hosts.
    """
    lost = [host.host_id for host in tables.hosts.values() if not host.alive]
    for host_id in sorted(lost):
        move_mailboxes(tables, host_id)
