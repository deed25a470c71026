"""Decides which changes of the directory a caller gets: changes of the things that it may list."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_runtime.access.control import allowed_to
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_supernode.core.records import ChannelRecord, DirectoryChange, GroupRecord, PeerRecord, QueueRecord


def visible_to_caller() -> Callable[[DirectoryChange], bool]:
    """Returns a function that decides whether the caller gets a change.

    The function judges each change by the rules that are in effect when it is called. Every caller gets the changes of
    hosts, and every AccessChange.
    """
    may_list = {kind: allowed_to(AccessVerb.LIST, kind) for kind in AccessKind}

    def is_shown(change: DirectoryChange) -> bool:
        match change.subject:
            case ChannelRecord(name=name):
                return may_list[AccessKind.CHANNEL](name)
            case GroupRecord(name=name):
                return may_list[AccessKind.GROUP](name)
            case QueueRecord(mailbox_peer_id=None, name=name):
                return may_list[AccessKind.QUEUE](name)
            case QueueRecord(mailbox_peer_name=name) | PeerRecord(name=name):
                return may_list[AccessKind.PEER](name)
            case _:
                return True

    return is_shown
