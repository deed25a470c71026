"""The rules of access to queues and mailboxes. Rules name a mailbox by its peer's name. The caller that registered the
peer owns the mailbox, and may take from it without a rule.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_runtime.access.control import check_access, check_known, owner_name
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb


def check_queue_access(
    verb: AccessVerb, queue: RecordedQueue, check: Callable[[AccessVerb, AccessKind, str], None] = check_access
) -> None:
    """Check that the caller may perform `verb` on the queue. Raises PermissionDenied if not, Unavailable if this host
    does not know the rules yet.

    `check` gets the right that is needed. It checks this right, or notes it for a request that waits.
    """
    if not queue.is_mailbox:
        check(verb, AccessKind.QUEUE, queue.name)
    elif not _is_owned(queue) or verb is not AccessVerb.TAKE:
        check(verb, AccessKind.PEER, queue.mailbox_peer_name)


def check_queue_known(queue: RecordedQueue) -> None:
    """Check that the caller may see the queue's status. Raises the errors of `check_queue_access`."""
    if not queue.is_mailbox:
        check_known(AccessKind.QUEUE, queue.name)
    elif not _is_owned(queue):
        check_known(AccessKind.PEER, queue.mailbox_peer_name)


def _is_owned(queue: RecordedQueue) -> bool:
    """Whether the caller registered the mailbox's peer. Always False for services of the cluster and operators."""
    return bool(queue.mailbox_owner) and queue.mailbox_owner == owner_name()
