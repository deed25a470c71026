"""The place of a replica to which its owner has sent something that the owner itself has not stored yet."""

from __future__ import annotations

from stampede_rt.errors import Unavailable


class AheadPlace:
    """The place of the replica of one feed. At most one item, or one step of a queue, is sent and not yet stored."""

    def __init__(self, host_id: bytes, strays: set[bytes]) -> None:
        """`host_id`: the host of the replica. `strays`: see `OwnedReplicas`."""
        self._host_id = host_id
        self._strays = strays
        self._unstored_next = 0  # the replica's place after it; 0: nothing is sent

    def sent(self, next_place: int) -> None:
        """Note that the feed sends something. `next_place`: the replica's place after it."""
        self._unstored_next = next_place

    def stored(self, next_place: int) -> bool:
        """Note that the owner has stored everything. Returns whether the replica has got all of it ahead.

        `next_place`: the owner's.
        """
        ahead, self._unstored_next = self._unstored_next, 0
        return ahead == next_place

    def take_back(self) -> Unavailable | None:
        """The error that ends the feed, because a defect kept the owner from storing it. None: nothing was sent.

        The replica must begin anew.
        """
        if not self._unstored_next:
            return None
        self._unstored_next = 0
        self._strays.add(self._host_id)
        return Unavailable("a defect kept the owner from storing a put, so its replicas begin anew")
