"""Where subscriptions stand (paper, section 4.1: push)."""

from __future__ import annotations

from collections import deque


class AllCursor:
    """Where a subscription in seq order stands. Made by `Channel.subscribe_all`, moved by `Channel.since`.

    `next_seq`: everything below it was delivered or reported in a gap, or is none of this subscription's;
    `delivered`, `dropped`: items given, and items reported in gaps, up to now.
    """

    __slots__ = ("_owed", "delivered", "dropped", "live_seq")

    def __init__(self, owed: deque[tuple[int, int]], live_seq: int) -> None:
        self._owed = owed
        self.live_seq = live_seq
        self.delivered = 0
        self.dropped = 0


class NewestCursor:
    """Where a subscription to the newest item stands. Made by `Channel.subscribe_newest`, moved by `Channel.latest`.

    `skipped`: items meant for the subscription that it was not given, as of the last `latest`.
    """

    __slots__ = ("delivered", "skipped")

    def __init__(self) -> None:
        self.delivered = 0
        self.skipped = 0
