"""Searches for an order of the operations, within their times, in which a sequential object gives the same answers.

The search of Wing and Gong (1993), with Lowe's memory of visited configurations (2017), as in Porcupine and Knossos:
choose an operation that no unfinished operation precedes; go back if no order fits; never visit a set of linearized
operations with the same state twice. PyPI has no such checker (Porcupine is Go, Knossos Clojure), and one page of code
costs less than another toolchain in the test suite.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from tests.robustness.histories.operations import Operation

State = TypeVar("State", bound=Hashable)
CONFIGURATIONS_MAX = 2_000_000


class NotLinearizable(AssertionError):
    """No order explains the answers."""


class SearchGivenUp(AssertionError):
    """The search ended without a proof, after too many configurations. This counts as a failure."""


@dataclass(slots=True)
class _Node:
    """A call or a return, in the doubly linked list of the operations that are not linearized yet, in the order of
    time.
    """

    position: int  # the operation's position
    is_call: bool
    before: _Node | None = None
    after: _Node | None = None
    match: _Node | None = None  # the call's return; None for an ambiguous call, which the order may leave out

    def lift(self) -> None:
        """Take a call and its return out of the list."""
        for node in (self, self.match):
            if node is not None:
                assert node.before is not None
                node.before.after = node.after
                if node.after is not None:
                    node.after.before = node.before

    def unlift(self) -> None:
        """Put a call and its return back, in reverse order."""
        for node in (self.match, self):
            if node is not None:
                assert node.before is not None
                node.before.after = node
                if node.after is not None:
                    node.after.before = node


def check_linearizable(
    operations: Sequence[Operation],
    initial: State,
    step: Callable[[State, Operation], State | None],
    *,
    configurations_max: int = CONFIGURATIONS_MAX,
) -> None:
    """Check the history. `step` gives the state after an operation, or None if the operation cannot have the
    recorded answer.

    Raises NotLinearizable with the operation at which every order fails, or SearchGivenUp.
    """
    head = _linked(operations)
    unfinished = sum(not operation.ambiguous for operation in operations)
    state, linearized = initial, 0
    visited: set[tuple[int, Hashable]] = set()
    trail: list[tuple[_Node, State]] = []
    node = head.after
    while unfinished:
        assert node is not None, "an unfinished operation's return is still in the list"
        if node.is_call:
            following = step(state, operations[node.position])
            configuration = (linearized | 1 << node.position, following)
            if following is not None and _is_new(configuration, visited, configurations_max):
                trail.append((node, state))
                state, linearized = following, linearized | 1 << node.position
                unfinished -= node.match is not None
                node.lift()
                node = head.after
            else:
                node = node.after
            continue
        if not trail:
            raise NotLinearizable(_explanation(operations, node.position))
        node, state = trail.pop()
        linearized &= ~(1 << node.position)
        unfinished += node.match is not None
        node.unlift()
        node = node.after


def _is_new(configuration: tuple[int, Hashable], visited: set[tuple[int, Hashable]], configurations_max: int) -> bool:
    """Whether the search reaches this configuration for the first time.

    Raises SearchGivenUp after too many configurations.
    """
    if configuration in visited:
        return False
    visited.add(configuration)
    if len(visited) > configurations_max:
        raise SearchGivenUp(f"the search tried more than {configurations_max} configurations without a proof")
    return True


def _linked(operations: Sequence[Operation]) -> _Node:
    """The list's head.

    If a call and a return have the same time, the call comes first, because they may have overlapped.
    """
    events: list[tuple[float, int, _Node]] = []
    for position, operation in enumerate(operations):
        call = _Node(position, True)
        events.append((operation.invoked, 0, call))
        if not operation.ambiguous:
            call.match = _Node(position, False)
            events.append((operation.returned, 1, call.match))
    head = last = _Node(-1, True)
    for _, _, node in sorted(events, key=lambda event: event[:2]):
        node.before, last.after, last = last, node, node
    return head


def _explanation(operations: Sequence[Operation], position: int) -> str:
    culprit = operations[position]
    lines = "\n".join(
        f"  {'>' if one is culprit else ' '} {one.invoked:10.4f} - {one.returned:10.4f}  {one.call}  ->  {one.answer}"
        for one in sorted(operations, key=lambda one: one.invoked)
    )
    return (
        f"key {culprit.key}: no order of these operations explains their answers; "
        f"> marks an operation that fits into no order\n{lines}"
    )
