"""Whether a request to open something still means it, when it comes late. Pure.

What is there is opened without an entry in the log, so nobody remembers that request. If the caller tried before, at
another supernode, that attempt may still be under way; arriving after the thing was deleted, it would make it again
although nobody wants it any more. So every attempt says how far the state reached when the request came in: if the name
has been freed since, nothing is made. A caller that is still there asks again; one that has its answer does not.
"""

from __future__ import annotations

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.answered import Answered
from stampede_rt_supernode.core.channels.commands import ChannelDeleted, OpenChannel
from stampede_rt_supernode.core.commands import Success
from stampede_rt_supernode.core.groups.commands import GroupDeleted, OpenGroup
from stampede_rt_supernode.core.queues.commands import OpenQueue, QueueDeleted
from stampede_rt_supernode.core.tables import Tables

Open = OpenChannel | OpenGroup | OpenQueue


def check_in_time(tables: Tables, answered: Answered, operation: Open, as_of_index: int) -> None:
    """Raises Unavailable with reason AMBIGUOUS if `operation` would make what may have been deleted since the request.

    `as_of_index`: how far the state reached when the request came, 0 if that is not told.
    O(entries since then). Deletions are known for as long as answers are remembered; what is older counts as late.
    """
    if as_of_index == 0 or _is_there(tables, operation):
        return
    if as_of_index < answered.known_since:
        raise _late(operation)
    for answer in answered.newest_first():
        if answer.index <= as_of_index:
            return
        if _frees(answer.result, operation):
            raise _late(operation)


def _is_there(tables: Tables, operation: Open) -> bool:
    match operation:
        case OpenChannel():
            return tables.channel_named(operation.name) is not None
        case OpenGroup():
            return tables.groups.named(operation.name) is not None
        case OpenQueue():
            return tables.queues.named(operation.name) is not None


def _frees(result: Success, operation: Open) -> bool:
    match operation:
        case OpenChannel():
            return isinstance(result, ChannelDeleted) and result.channel.name == operation.name
        case OpenGroup():
            return isinstance(result, (GroupDeleted, ChannelDeleted))  # of which group is not remembered
        case OpenQueue():
            return isinstance(result, QueueDeleted) and result.queue.name == operation.name


def _late(operation: Open) -> Unavailable:
    kind = type(operation).__name__.removeprefix("Open").lower()
    return Unavailable(
        f"{kind} {operation.name} may have been deleted while this request was under way; send the request again, with "
        "the same request id, if it is still wanted",
        reason="AMBIGUOUS",
        metadata={kind: operation.name},
    )
