"""The copies of channels that the gets of one connection use (paper, sections 4.1 and 4.2). Pure."""

from __future__ import annotations

from stampede_rt.cluster.binding import Binding

ENTRIES_MAX = 10_000


class CopyCache:
    """By channel: the binding of a copy, or that there is none to use, each until some moment.

    The cache is bounded: a full cache drops its entries and starts again.
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
