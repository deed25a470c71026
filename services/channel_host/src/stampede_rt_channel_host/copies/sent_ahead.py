"""Notes the run or step that the owner has sent ahead to a replica, and has not stored itself yet."""

from __future__ import annotations

from stampede_rt.errors import Unavailable


class SentAhead:
    """The run of a channel, or the step of a queue, that one feed has sent ahead to its replica; at most one at a time.

    A place is a seq or the number of a step, as in `OwnedReplicas`.
    """

    def __init__(self, host_id: bytes, diverged_host_ids: set[bytes]) -> None:
        """`host_id`: the host of the replica. `diverged_host_ids`: the set of this name in `OwnedReplicas`."""
        self._host_id = host_id
        self._diverged_host_ids = diverged_host_ids
        self._unstored_next = 0  # the place after the run or step that is sent ahead; 0: there is none

    def sent(self, next_place: int) -> None:
        """Note that the feed sends a run or step ahead. `next_place`: the place after this run or step."""
        self._unstored_next = next_place

    def stored(self, next_place: int) -> bool:
        """Note that the owner has stored everything before `next_place`.

        Returns whether the feed has sent the run or step before `next_place` ahead, and so need not send it now.
        """
        ahead, self._unstored_next = self._unstored_next, 0
        return ahead == next_place

    def take_back(self) -> Unavailable | None:
        """Note that a defect kept the owner from storing the run or step, so the replica must begin anew.

        Returns the error that ends the feed; None: nothing was sent ahead.
        """
        if not self._unstored_next:
            return None
        self._unstored_next = 0
        self._diverged_host_ids.add(self._host_id)
        return Unavailable("a defect kept the owner from storing a put, so its replicas begin anew")
