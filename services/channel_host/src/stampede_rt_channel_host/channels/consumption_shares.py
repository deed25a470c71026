"""The memory that one caller's out-of-order consumption may take up at a host."""

from __future__ import annotations

from collections import Counter
from typing import Protocol
from weakref import WeakKeyDictionary

from stampede_rt.errors import Overloaded


class ConsumingChannel(Protocol):
    """A channel, as far as its consumers concern it."""

    def consumption_bytes_of(self, owner: str) -> int:
        """The memory of the places of one caller, and of what these have consumed out of order, in bytes."""


class ConsumptionShares:
    """Limits the memory of each caller's consumer places, over all channels of a host.

    Consumption may go on when puts may not, because it lets items leave. Without this limit one caller could fill the
    host's memory by consuming every second item at many places.
    """

    def __init__(self, bytes_max: int) -> None:
        """`bytes_max`: the most for one caller."""
        self._bytes_max = bytes_max
        # what each channel told at the last consumption; it may have become less since
        self._told: dict[str, WeakKeyDictionary[ConsumingChannel, int]] = {}
        self._bytes: Counter[str] = Counter()

    def has_room(self, owner: str, more_bytes: int) -> bool:
        """Whether the caller may have `more_bytes` more, without a new look at its channels."""
        return not owner or self._bytes[owner] + more_bytes <= self._bytes_max

    def check(self, owner: str, more_bytes: int) -> None:
        """Raises Overloaded if the caller may not have `more_bytes` more."""
        if more_bytes and not self.has_room(owner, more_bytes):
            self._look_again(owner)
            if not self.has_room(owner, more_bytes):
                raise Overloaded(
                    f"what {owner} has consumed out of order takes {self._bytes[owner]} bytes at this host, of at most "
                    f"{self._bytes_max} for one caller; consume in order, or with fewer consumers",
                    metadata={"subject": owner, "used": str(self._bytes[owner]), "limit": str(self._bytes_max)},
                )

    def note(self, owner: str, channel: ConsumingChannel) -> None:
        """Look at the memory of the caller's places in this channel, after a consumption."""
        if owner:
            told, now = self._told.setdefault(owner, WeakKeyDictionary()), channel.consumption_bytes_of(owner)
            self._bytes[owner] += now - told.get(channel, 0)
            told[channel] = now

    def _look_again(self, owner: str) -> None:
        told = {channel: channel.consumption_bytes_of(owner) for channel in self._told.get(owner, ())}
        self._told[owner] = WeakKeyDictionary({channel: found for channel, found in told.items() if found})
        self._bytes[owner] = sum(told.values())
