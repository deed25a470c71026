"""The memory that one caller's out-of-order consumption may take up at a host."""

from __future__ import annotations

from collections import Counter
from typing import Protocol
from weakref import WeakKeyDictionary

from stampede_rt.errors import Overloaded


class ConsumingChannel(Protocol):
    """The method of a channel that this module calls."""

    def consumption_bytes_of(self, caller_name: str) -> int:
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

    def has_room(self, caller_name: str, more_bytes: int) -> bool:
        """Whether the caller may use `more_bytes` more. Unlike `check`, does not measure the channels again."""
        return not caller_name or self._bytes[caller_name] + more_bytes <= self._bytes_max

    def check(self, caller_name: str, more_bytes: int) -> None:
        """Raises Overloaded if the caller may not use `more_bytes` more."""
        if more_bytes and not self.has_room(caller_name, more_bytes):
            self._measure_again(caller_name)
            if not self.has_room(caller_name, more_bytes):
                used_bytes = self._bytes[caller_name]
                raise Overloaded(
                    f"the out-of-order consumption of {caller_name} takes {used_bytes} bytes at this host, of at most "
                    f"{self._bytes_max} for one caller; consume in order, or with fewer consumers",
                    metadata={"subject": caller_name, "used": str(used_bytes), "limit": str(self._bytes_max)},
                )

    def note(self, caller_name: str, channel: ConsumingChannel) -> None:
        """Measure the memory of the caller's places in this channel, after a consumption."""
        if caller_name:
            measured = self._measured.setdefault(caller_name, WeakKeyDictionary())
            used_bytes = channel.consumption_bytes_of(caller_name)
            self._bytes[caller_name] += used_bytes - measured.get(channel, 0)
            measured[channel] = used_bytes

    def _measure_again(self, caller_name: str) -> None:
        measured = {
            channel: channel.consumption_bytes_of(caller_name) for channel in self._measured.get(caller_name, ())
        }
        self._measured[caller_name] = WeakKeyDictionary(
            {channel: found for channel, found in measured.items() if found}
        )
        self._bytes[caller_name] = sum(measured.values())
