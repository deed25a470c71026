"""The copies of channels that the gets of one connection use (paper, sections 4.1 and 4.2). Pure."""

from __future__ import annotations

from stampede_rt.cluster.binding import Binding

ENTRIES_MAX = 10_000


class CopyCache:
    """For each channel: the binding of a copy to use, or the fact that there is none. Each entry is valid until an
    instant.

    The cache is bounded: a full cache drops all its entries.
    """

    def __init__(self) -> None:
        self._known: dict[bytes, tuple[Binding | None, float]] = {}

    def find(self, channel_id: bytes, now_s: float) -> tuple[bool, Binding | None]:
        """Return whether the cache has an entry that is still valid, and its copy; None: there is none to use."""
        binding, until_s = self._known.get(channel_id, (None, float("-inf")))
        return until_s > now_s, binding

    def keep(self, channel_id: bytes, binding: Binding | None, until_s: float) -> None:
        """Use this copy, or none, until `until_s`."""
        if len(self._known) >= ENTRIES_MAX:
            self._known.clear()
        self._known[channel_id] = binding, until_s
