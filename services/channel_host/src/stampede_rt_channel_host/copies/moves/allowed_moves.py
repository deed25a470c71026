"""The moves that permitted callers have asked this host for. This host owns the channels and queues.

The request of another host is not enough. Before that request, a caller with the right to configure the channel, or
this host itself, must have named the other host (decision 0222).
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable

from stampede_rt.errors import PermissionDenied
from stampede_rt_runtime.access.move_permits import move_permit

ALLOWED_SECONDS = 60.0  # from the request of the caller to the first request of the other host
ALLOWED_MAX = 4096  # beyond this number, the oldest is dropped


class AllowedMoves:
    """The next owners that callers have named, each for one channel or queue at one epoch, and the permits for them."""

    def __init__(self, key: bytes, clock_s: Callable[[], float] = time.monotonic) -> None:
        """`key`: the key of this host's permits, see `move_permits`; empty: the directory requires no permits."""
        self._key = key
        self._clock_s = clock_s
        self._allowed: OrderedDict[tuple[bytes, int, bytes], float] = OrderedDict()

    def allow(self, subject_id: bytes, epoch: int, to_host_id: bytes) -> None:
        """Let that host ask for the channel or queue, for ALLOWED_SECONDS. Idempotent."""
        named = (subject_id, epoch, to_host_id)
        self._allowed[named] = self._clock_s() + ALLOWED_SECONDS
        self._allowed.move_to_end(named)
        if len(self._allowed) > ALLOWED_MAX:
            self._allowed.popitem(last=False)

    def check(self, name: str, subject_id: bytes, epoch: int, to_host_id: bytes) -> None:
        """Raises PermissionDenied if no caller named that host. `name` is the name of the channel or queue."""
        until_s = self._allowed.get((subject_id, epoch, to_host_id))
        if until_s is None or until_s < self._clock_s():
            raise PermissionDenied(
                f"no caller has asked this host to hand {name} over to host {to_host_id.hex()}; move it with `stampede "
                "move`, or call AllowMove here first",
                metadata={"host_id": to_host_id.hex()},
            )

    def permit(self, subject_id: bytes, epoch: int, to_host_id: bytes) -> bytes:
        """The permit for the directory.

        Give it to that host as soon as it has everything, and nothing changes any more.
        """
        return move_permit(self._key, subject_id, epoch, to_host_id) if self._key else b""
