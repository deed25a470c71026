"""Remembers the latest requests that deleted a channel, so that a repeated request succeeds."""

from __future__ import annotations

from collections import Counter, OrderedDict

DELETIONS_MAX = 1024


class Deletions:
    """The ids of the latest requests that deleted a channel, at most DELETIONS_MAX.

    When one more id comes, this class drops the oldest id of the caller with the most ids. So one caller does not push
    out the ids of other callers.
    """

    def __init__(self) -> None:
        self._callers: OrderedDict[bytes, str] = OrderedDict()  # by request id, the oldest first

    def __contains__(self, request_id: bytes) -> bool:
        return request_id in self._callers

    def note(self, request_id: bytes, caller: str) -> None:
        """Remember a request of `caller`; empty for a caller without a name of its own."""
        self._callers[request_id] = caller
        if len(self._callers) > DELETIONS_MAX:
            [(largest, _)] = Counter(self._callers.values()).most_common(1)
            del self._callers[next(one for one, whose in self._callers.items() if whose == largest)]
