"""The memory that one caller's out-of-order consumption may take up at a host."""

from __future__ import annotations

from collections import Counter
from typing import Protocol
from weakref import WeakKeyDictionary

from stampede_rt.errors import Overloaded


class ConsumingChannel(Protocol):
    """The method of a channel that this module calls."""

    def consumption_bytes_of(self, owner: str) -> int:
        """The memory of one caller's consumer places, and of the seqs consumed out of order at them, in bytes."""


class ConsumptionShares:
    """Limits the memory of each caller's consumer places, over all channels of a host.

    Consumption frees items, so the host still allows it when the memory for puts is used up. Without this limit one
    caller could fill the host's memory by consuming every second item at many places.
    """

    def __init__(self, bytes_max: int) -> None:
        """`bytes_max`: the most memory for one caller."""
        self._bytes_max = bytes_max
        # by caller and channel: the memory at the caller's last consumption there; it may have become less since
        self._measured: dict[str, WeakKeyDictionary[ConsumingChannel, int]] = {}
        self._bytes: Counter[str] = Counter()  # by caller: the sum over the channels

    def has_room(self, owner: str, more_bytes: int) -> bool:
        """Whether the caller may use `more_bytes` more. Unlike `check`, does not measure the channels again."""
        return not owner or self._bytes[owner] + more_bytes <= self._bytes_max

    def check(self, owner: str, more_bytes: int) -> None:
        """Raises Overloaded if the caller may not use `more_bytes` more."""
        if more_bytes and not self.has_room(owner, more_bytes):
            self._measure_again(owner)
            if not self.has_room(owner, more_bytes):
                raise Overloaded(
                    f"the out-of-order consumption of {owner} takes {self._bytes[owner]} bytes at this host, of at "
                    f"most {self._bytes_max} for one caller; consume in order, or with fewer consumers",
                    metadata={"subject": owner, "used": str(self._bytes[owner]), "limit": str(self._bytes_max)},
                )

    def note(self, owner: str, channel: ConsumingChannel) -> None:
        """Measure the memory of the caller's places in this channel, after a consumption."""
        if owner:
            measured, now = self._measured.setdefault(owner, WeakKeyDictionary()), channel.consumption_bytes_of(owner)
            self._bytes[owner] += now - measured.get(channel, 0)
            measured[channel] = now

    def _measure_again(self, owner: str) -> None:
        measured = {channel: channel.consumption_bytes_of(owner) for channel in self._measured.get(owner, ())}
        self._measured[owner] = WeakKeyDictionary({channel: found for channel, found in measured.items() if found})
        self._bytes[owner] = sum(measured.values())
