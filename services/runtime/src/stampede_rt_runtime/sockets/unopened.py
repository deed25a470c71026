"""The connections of a port that have sent no opening yet. Anybody may hold such connections."""

from __future__ import annotations

from collections import Counter

from stampede_rt_runtime.sockets.stream_socket import StreamSocket


class UnopenedStreams:
    """Limits the number of these connections, in all and for each machine (decision 0153). So one machine leaves room
    for the others."""

    def __init__(self, connections_max: int, per_machine_max: int) -> None:
        self._connections_max, self._per_machine_max = connections_max, per_machine_max
        self._all: set[StreamSocket] = set()
        self._counts_by_machine: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._all)

    def has_room_for(self, machine: str) -> bool:
        """Whether the service may take another connection of this machine."""
        return len(self._all) < self._connections_max and self._counts_by_machine[machine] < self._per_machine_max

    def add(self, connection: StreamSocket) -> None:
        """Note a new connection."""
        self._all.add(connection)
        self._counts_by_machine[connection.machine] += 1

    def discard(self, connection: StreamSocket) -> None:
        """Note that a connection has sent its opening, or has ended. Idempotent."""
        if connection not in self._all:
            return
        self._all.remove(connection)
        self._counts_by_machine[connection.machine] -= 1
        if not self._counts_by_machine[connection.machine]:
            del self._counts_by_machine[connection.machine]
