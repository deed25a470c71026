"""The number of connections without an opening that each machine may have."""

from __future__ import annotations

from typing import Any

from stampede_rt_runtime.sockets.unopened import UnopenedStreams


class Connection:
    """A connection of one machine. Two connections are equal only if they are the same object, as with StreamSocket."""

    def __init__(self, machine: str) -> None:
        self.machine = machine


def test_a_machine_that_uses_up_its_share_does_not_affect_others() -> None:
    unopened = UnopenedStreams(4, 3)
    held: list[Any] = [Connection("10.0.0.3") for _ in range(3)]
    for one in held:
        assert unopened.has_room_for("10.0.0.3")
        unopened.add(one)
    assert not unopened.has_room_for("10.0.0.3")
    assert unopened.has_room_for("10.0.0.4")
    other: Any = Connection("10.0.0.4")
    unopened.add(other)
    assert not unopened.has_room_for("10.0.0.5"), "the connections of all machines together are bounded, too"
    for _ in range(2):
        unopened.discard(held[0])
    assert len(unopened) == 3
    assert unopened.has_room_for("10.0.0.3")
    for one in (*held, other):
        unopened.discard(one)
    assert len(unopened) == 0
    assert not unopened._counts_by_machine, "nothing is kept of a machine without such connections"
