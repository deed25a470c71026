"""Whether a request to open something still means it, when it comes late. Pure.

What is there is opened without an entry in the log, so nobody remembers that request. If the caller tried before, at
another supernode, that attempt may still be under way; arriving after the thing was deleted, it would make it again
although nobody wants it any more. So every attempt says how far the state reached when the request came in: if the name
has been freed since, nothing is made. A caller that is still there asks again; one that has its answer does not.
"""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.errors import Unavailable
from stampede_rt_supernode.core.answered import Answered
from stampede_rt_supernode.core.commands import Success


def check_in_time(
    answered: Answered, thing: tuple[str, str], as_of_index: int, frees: Callable[[Success], bool]
) -> None:
    """Raises Unavailable with reason AMBIGUOUS if the thing to be made may have been deleted since the request.

    `thing`: its kind and name; it is not there now. `as_of_index`: how far the state reached when the request came, 0
    if that is not told. `frees`: whether what was done has freed the name. O(entries since then). Deletions are known
    for as long as answers are remembered; what is older counts as late.
    """
    if as_of_index == 0:
        return
    if as_of_index < answered.known_since:
        raise _late(*thing)
    for answer in answered.newest_first():
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
