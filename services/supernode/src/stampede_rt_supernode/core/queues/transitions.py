"""Opens, changes and deletes queues in the tables (paper, section 3.5). Pure.

As in `channels.transitions`, a function either raises a StampedeError without any change, or succeeds. Mailboxes come
and go with their peers, see `peers.transitions`.
"""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument, Overloaded, StaleBinding
from stampede_rt_supernode.core.lookups import check_host_agrees, no_such_queue, queue_by_id
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)
from stampede_rt_supernode.core.queues.placement import choose_host, give_queue, with_new_incarnation
from stampede_rt_supernode.core.queues.specs import agree, check_queue_spec, check_replicas, merge
from stampede_rt_supernode.core.records import QueueRecord, QueueSpec
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id, check_incarnation, check_name

QUEUES_MAX = 200_000  # mailboxes included
# The most steps from a queue to its dead-letter queue, from there to the dead-letter queue of that queue, and so on.
DEAD_LETTER_STEPS_MAX = 16


def check_open_queue(operation: OpenQueue) -> None:
    """Check the operation without the tables. Raises InvalidName or InvalidArgument."""
    check_name(operation.name, "queue")
    if operation.host_name:
        check_name(operation.host_name, "host")
    check_queue_spec(operation.name, operation.spec)
    check_id(operation.new_queue_id, "new_queue_id")
    check_incarnation(operation.new_incarnation, "new_incarnation")


def check_update_queue(operation: UpdateQueue) -> None:
    """Check the operation without the tables. Raises InvalidArgument."""
    check_id(operation.queue_id, "queue_id")
    check_queue_spec(operation.queue_id.hex(), operation.spec)


def open_queue(tables: Tables, operation: OpenQueue) -> QueueOpened:
    """Get or create a queue.

    A queue whose owner's lease has ended gets a new owner, epoch and incarnation. Its messages are lost. Raises
    QUEUE_NOT_FOUND, QUEUE_EXISTS, InvalidName, InvalidArgument, Overloaded, or the errors of the choice of a host.
    """
    check_open_queue(operation)
    queue = tables.queues.named(operation.name)
    if queue is None:
        return _create(tables, operation)
    check_host_agrees("queue", queue.name, tables.hosts[queue.host_id], operation.host_name)
    opened = _agreed(tables, queue, operation.spec)
    if not tables.hosts[queue.host_id].alive:
        host = choose_host(tables, f"queue {queue.name}", operation.host_name, tables.hosts[queue.host_id].name)
        opened = with_new_incarnation(opened, host, operation.new_incarnation)
    give_queue(tables, queue, opened)
    return QueueOpened(queue=opened, host=tables.hosts[opened.host_id], created=False)


def open_queue_unchanged(tables: Tables, operation: OpenQueue) -> QueueOpened | None:
    """The answer to `operation` if it changes nothing; otherwise None.

    Raises the errors of `open_queue`, except errors about a lack of room or of a host.
    """
    check_open_queue(operation)
    queue = tables.queues.named(operation.name)
    if queue is None:
        if not operation.create:
            raise no_such_queue(operation.name)
        return None
    host = tables.hosts[queue.host_id]
    check_host_agrees("queue", queue.name, host, operation.host_name)
    unchanged = _agreed(tables, queue, operation.spec) == queue
    return QueueOpened(queue=queue, host=host, created=False) if unchanged and host.alive else None


def _agreed(tables: Tables, queue: QueueRecord, requested: QueueSpec) -> QueueRecord:
    return _with_spec(tables, queue, agree(queue.name, queue.spec, requested))


def _with_spec(tables: Tables, queue: QueueRecord, spec: QueueSpec) -> QueueRecord:
    """`queue` with this policy. If the policy differs, `spec_version` is one higher."""
    if spec == queue.spec:
        return queue
    check_dead_letter(tables, queue.queue_id, queue.name or queue.queue_id.hex(), spec)
    check_replicas(queue.name or queue.queue_id.hex(), spec)
    return replace(queue, spec=spec, spec_version=queue.spec_version + 1)


def _create(tables: Tables, operation: OpenQueue) -> QueueOpened:
    if not operation.create:
        raise no_such_queue(operation.name)
    tables.queues.creators.check(operation, "queues")
    check_room(tables, f"queue {operation.name}")
    check_dead_letter(tables, operation.new_queue_id, operation.name, operation.spec)
    check_replicas(operation.name, operation.spec)
    host = choose_host(tables, f"queue {operation.name}", operation.host_name)
    queue = QueueRecord(
        queue_id=operation.new_queue_id,
        name=operation.name,
        host_id=host.host_id,
        epoch=1,
        incarnation=operation.new_incarnation,
        spec=operation.spec,
        spec_version=1,
        created_by=operation.created_by,
    )
    tables.put_queue(queue)
    return QueueOpened(queue=queue, host=host, created=True)


def check_room(tables: Tables, queue: str) -> None:
    """Raises Overloaded if there is no room for another queue or mailbox."""
    if len(tables.queues) >= QUEUES_MAX:
        text = f"{queue} cannot be created: the directory holds {QUEUES_MAX} queues, the limit; delete some"
        raise Overloaded(text, metadata={"queue": queue})


def check_dead_letter(tables: Tables, queue_id: bytes, shown: str, spec: QueueSpec) -> None:
    """Check that the dead-letter queue exists, is not a mailbox, and does not lead back to the queue.

    `queue_id`, `shown`: the id and the shown name of the queue whose policy is `spec`. Raises QUEUE_NOT_FOUND or
    InvalidArgument.
    """
    following = spec.dead_letter_queue_id
    for _ in range(DEAD_LETTER_STEPS_MAX + 1):
        if following is None:
            return
        if following == queue_id:
            raise _bad_dead_letter(shown, "leads back to the queue itself, so no dead letter would ever leave")
        dead_letter = queue_by_id(tables, following)
        if dead_letter.mailbox_peer_id is not None:
            raise _bad_dead_letter(shown, "is a mailbox, which ends with its peer")
        following = dead_letter.spec.dead_letter_queue_id
    raise _bad_dead_letter(shown, f"begins a chain of more than {DEAD_LETTER_STEPS_MAX} dead-letter queues")


def _bad_dead_letter(queue: str, what: str) -> InvalidArgument:
    text = f"queue {queue}: its dead-letter queue {what}; name another queue"
    return InvalidArgument(text, metadata={"queue": queue, "field": "dead_letter_queue_id"})


def update_queue(tables: Tables, operation: UpdateQueue) -> QueueUpdated:
    """Change the stated fields of a queue's policy. The other fields stay.

    Raises QUEUE_NOT_FOUND, StaleBinding, or InvalidArgument for an impossible policy.
    """
    check_update_queue(operation)
    queue = queue_by_id(tables, operation.queue_id)
    check_queue_epoch(queue, operation.epoch)
    changed = _with_spec(tables, queue, merge(queue.spec, operation.spec))
    tables.put_queue(changed)
    return QueueUpdated(queue=changed)


def check_queue_epoch(queue: QueueRecord, epoch: int) -> None:
    """Raises StaleBinding with reason WRONG_EPOCH if the queue has another epoch."""
    if epoch != queue.epoch:
        shown = queue.name or queue.queue_id.hex()
        raise StaleBinding(
            f"queue {shown} is at epoch {queue.epoch}, not {epoch}: its host has changed or restarted; "
            "resolve it again",
            reason="WRONG_EPOCH",
            metadata={"queue": shown, "epoch": str(queue.epoch)},
        )


def delete_queue(tables: Tables, operation: DeleteQueue) -> QueueDeleted:
    """Delete a queue, and free its name. Raises InvalidArgument for a mailbox, or for a dead-letter queue in use."""
    queue = queue_by_id(tables, operation.queue_id)
    shown = queue.name or queue.queue_id.hex()
    if queue.mailbox_peer_id is not None:
        text = (
            f"queue {shown} is the mailbox of peer {queue.mailbox_peer_id.hex()} and is deleted when that peer leaves"
        )
        raise InvalidArgument(text, metadata={"queue": shown})
    feeding = tables.queues.feeding(queue.queue_id)
    if feeding:
        other = feeding[0].name or feeding[0].queue_id.hex()
        text = f"queue {shown} is the dead-letter queue of {other}; give that queue another one, or delete it first"
        raise InvalidArgument(text, metadata={"queue": shown, "dead_letter_of": other})
    tables.remove_queue(queue)
    return QueueDeleted(queue=queue)
