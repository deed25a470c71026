"""Remembers the sources that send the last message of a copy slowly. They must not hold a channel early. Pure."""

from __future__ import annotations

from collections import OrderedDict

SLOW_SECONDS = 0.5
REMEMBERED_SECONDS = 60.0
HOSTS_MAX = 256


class EarlyHolds:
    """Decides whether a source may hold a channel before this host has the last message of the copy.

    Puts wait while the channel is held, so a slow last message would delay them. `now_s` is monotonic.
    """

    def __init__(self) -> None:
        self._slow_until_s: OrderedDict[str, float] = OrderedDict()  # by the gatekeeper of the source

    def may_hold(self, target: str, now_s: float) -> bool:
        """Whether the source at `target` may hold the channel early."""
        return self._slow_until_s.get(target, now_s) <= now_s

    def note_wait(self, target: str, seconds: float, now_s: float) -> None:
        """Note how long this host has waited for a last message, from a source that was allowed to hold early."""
        if seconds <= SLOW_SECONDS:
            return
        self._slow_until_s[target] = now_s + REMEMBERED_SECONDS
        self._slow_until_s.move_to_end(target)
        if len(self._slow_until_s) > HOSTS_MAX:
            self._slow_until_s.popitem(last=False)
