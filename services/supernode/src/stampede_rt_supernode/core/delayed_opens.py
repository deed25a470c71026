"""Decides whether a late request to open something is still wanted. Pure.

An open of an existing thing makes no log entry, so no supernode remembers the request. If the caller first tried at
another supernode, that attempt may still be under way. It may arrive after the thing was deleted, and would create it
again, although no caller wants it any more. So each supernode puts a log position into the command that it proposes:
the position of its state when it received the request. If the name has become free since, the directory creates
nothing. A caller that still waits sends the request again. A caller that has its answer does not send it again.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.commands import Success
from stampede_rt_supernode.core.kept_answers import KeptAnswers


def check_not_late(
    kept_answers: KeptAnswers, thing: tuple[str, str], as_of_index: int, frees: Callable[[Success], bool]
) -> None:
    """Raises Unavailable with reason AMBIGUOUS if the thing to create may have been deleted since the request.

    `thing`: its kind and name; it must not exist now. `as_of_index`: the log position of the
    supernode's state when it received the request; 0 if it is unknown, and then the check passes. `frees`: whether a
    result means that the name became free. O(entries since the request). The directory knows of a deletion for as long
    as it keeps the answer. A request is also late if the directory has forgotten answers that are newer than the
    request.
    """
    if as_of_index == 0:
        return
    if as_of_index < kept_answers.known_since:
        raise _late(*thing)
    for answer in kept_answers.newest_first():
        if answer.index <= as_of_index:
            return
        if frees(answer.result):
            raise _late(*thing)


def _late(kind: str, name: str) -> Unavailable:
    return Unavailable(
        f"{kind} {name} may have been deleted while this request was under way; send the request again, with "
        "the same request id, if it is still wanted",
        reason="AMBIGUOUS",
        metadata={kind: name},
    )
