"""The rows of queues in the command table. Pure."""

from __future__ import annotations

from typing import Any

from stampede_rt_supernode.core import delayed_opens
from stampede_rt_supernode.core.command_kinds import CommandKind, on_tables, on_tables_with_creator
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)
from stampede_rt_supernode.core.queues.transitions import (
    check_open_queue,
    check_update_queue,
    delete_queue,
    open_queue,
    update_queue,
)
from stampede_rt_supernode.core.state import DirectoryState
from stampede_rt_supernode.core.validation import check_id


def _check_open_not_late(state: DirectoryState, operation: OpenQueue, as_of_index: int) -> None:
    if state.tables.queues.named(operation.name) is None:
        delayed_opens.check_not_late(
            state.kept_answers,
            ("queue", operation.name),
            as_of_index,
            lambda done: isinstance(done, QueueDeleted) and done.queue.name == operation.name,
        )


KINDS: tuple[CommandKind[Any, Any], ...] = (
    CommandKind(
        operation=OpenQueue,
        result=QueueOpened,
        feature_level=1,
        subject=lambda one: one.name,
        check=check_open_queue,
        check_not_late=_check_open_not_late,
        apply=on_tables_with_creator(open_queue),
    ),
    CommandKind(
        operation=UpdateQueue,
        result=QueueUpdated,
        feature_level=1,
        subject=lambda one: one.queue_id.hex(),
        check=check_update_queue,
        apply=on_tables(update_queue),
    ),
    CommandKind(
        operation=DeleteQueue,
        result=QueueDeleted,
        feature_level=1,
        subject=lambda one: one.queue_id.hex(),
        check=lambda one: check_id(one.queue_id, "queue_id"),
        apply=on_tables(delete_queue),
    ),
)
