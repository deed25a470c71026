"""The oracle's subscriptions: the seqs that a reader is owed, and its next newest item."""

from __future__ import annotations

from tests.oracle.channel import Item, OracleChannel


class OracleSubscription:
    """Every owed item is delivered once, in the order of seqs, or reported missing once it is no longer held."""

    def __init__(self, channel: OracleChannel, owed_at_first: list[int]) -> None:
        self.channel = channel
        self._owed = sorted(owed_at_first)
        self._known = len(channel.log)

    def owed(self) -> list[int]:
        """The owed seqs in order: all accepted items since the beginning that were not delivered or reported."""
        latest = len(self.channel.log)
        self._owed += range(self._known + 1, latest + 1)
        self._known = latest
        return self._owed

    def is_held(self, seq: int) -> bool:
        return any(item.seq == seq for item in self.channel.held)

    def settle(self, seqs: list[int]) -> None:
        """Note that these seqs were delivered or reported. They must be the first owed ones."""
        assert self.owed()[: len(seqs)] == seqs
        del self._owed[: len(seqs)]


class OracleNewest:
    """The newest item, if it is later than the last delivered one. All other items between the two count as skipped."""

    def __init__(self, channel: OracleChannel, last: tuple[int, int] | None, meant: list[int]) -> None:
        self.channel = channel
        self.last = last
        self.meant = set(meant)
        self._known = len(channel.log)
        self.given = 0

    def take(self) -> Item | None:
        self.meant |= set(range(self._known + 1, len(self.channel.log) + 1))
        newest = max(self.channel.held, default=None)
        if newest is None or (self.last is not None and (newest.time, newest.seq) <= self.last):
            return None
        self.last = (newest.time, newest.seq)
        self.given += 1
        return newest

    @property
    def skipped(self) -> int:
        return max(0, len(self.meant) - self.given)
