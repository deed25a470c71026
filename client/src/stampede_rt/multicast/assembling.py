"""Puts the parts of messages together, in bounded memory. Pure."""

from __future__ import annotations

from stampede_rt.multicast.layout import MessageKind, MessagePart, MulticastMessage

PART_OVERHEAD_BYTES = 160
"""The approximate memory of a kept part besides its data."""
MESSAGE_OVERHEAD_BYTES = 320
"""The approximate memory of an incomplete message, besides its parts."""

_Key = tuple[MessageKind, int, int, int]


class Assembler:
    """Keeps the parts of incomplete messages. Above `bytes_max` it gives up the message whose first part came first.

    `kept_bytes`: the memory of the parts. `repeated`: the parts that came twice. `given_up`: the messages that it gave
    up above `bytes_max`.
    """

    def __init__(self, bytes_max: int) -> None:
        self._bytes_max = bytes_max
        self._parts: dict[_Key, dict[int, bytes]] = {}
        self.kept_bytes = self.repeated = self.given_up = 0

    def add(self, part: MessagePart) -> MulticastMessage | None:
        """Keep a part. Returns the message if this was its last missing part."""
        key = part.kind, part.first_seq, part.end_seq, part.count
        if part.count == 1:
            return MulticastMessage(*key[:3], part.data)
        if key not in self._parts:
            self._parts[key] = {}
            self.kept_bytes += MESSAGE_OVERHEAD_BYTES
        parts = self._parts[key]
        if part.index in parts:
            self.repeated += 1
            return None
        parts[part.index] = part.data
        self.kept_bytes += len(part.data) + PART_OVERHEAD_BYTES
        if len(parts) == part.count:
            self._forget(key)
            return MulticastMessage(*key[:3], b"".join(parts[index] for index in range(part.count)))
        self._keep_to_bound()
        return None

    def forget_before(self, next_seq: int) -> None:
        """Forget the messages that only have seqs below `next_seq`: the reader has their items."""
        for key in [key for key in self._parts if key[2] <= next_seq]:
            self._forget(key)

    def _keep_to_bound(self) -> None:
        while self.kept_bytes > self._bytes_max:
            self._forget(next(iter(self._parts)))
            self.given_up += 1

    def _forget(self, key: _Key) -> None:
        parts = self._parts.pop(key)
        self.kept_bytes -= MESSAGE_OVERHEAD_BYTES + sum(len(data) + PART_OVERHEAD_BYTES for data in parts.values())
