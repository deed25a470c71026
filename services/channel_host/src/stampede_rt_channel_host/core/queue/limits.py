"""The policy of a queue, checked and with its defaults filled in (paper, section 3.5). Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.queueing import QueuePolicy

BLOCK, REJECT, DROP_OLDEST = "block", "reject", "drop_oldest"
ITEM_OVERHEAD_BYTES = 64
"""The bytes that a message counts against max_bytes in addition to its payload."""
ITEM_BYTES_MAX = 16 * 2**20
"""The largest payload of a message in any queue."""
# the limits that a policy states as numbers, perhaps as None
_NUMBERS = ("max_items", "max_bytes", "max_item_bytes", "copies", "lease_nanos", "max_deliveries")
LEASE_NANOS_MAX = 3_600_000_000_000
"""The longest lease that a taker may ask for."""


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueLimits:
    """The limits of a queue. A field is None if the queue has no such limit.

    Raises InvalidArgument if a value is out of its range.
    """

    max_items: int | None = None
    max_bytes: int = 256 * 2**20
    max_item_bytes: int = ITEM_BYTES_MAX
    on_full: str = BLOCK
    copies: int = 1
    lease_nanos: int = 30_000_000_000
    max_deliveries: int | None = None
    dead_letters: bool = False
    """Whether the queue has a dead-letter queue. Without one, the queue removes the messages that it gives up."""

    @classmethod
    def of(cls, policy: QueuePolicy) -> QueueLimits:
        """The limits of a policy, with the defaults for values that it does not state.

        Raises InvalidArgument if a value is out of its range.
        """
        values: dict[str, Any] = {name: getattr(policy, name) for name in _NUMBERS}
        stated = {name: value for name, value in values.items() if value is not None}
        return cls(on_full=policy.on_full or BLOCK, dead_letters=policy.dead_letter_queue_id is not None, **stated)

    def __post_init__(self) -> None:
        for name in ("max_items", "max_bytes", "copies", "lease_nanos", "max_deliveries"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InvalidArgument(f"{name} is {value}; it is at least 1, or left out")
        if not 0 <= self.max_item_bytes <= ITEM_BYTES_MAX:
            raise InvalidArgument(f"max_item_bytes is {self.max_item_bytes}; it must be between 0 and {ITEM_BYTES_MAX}")
        if self.on_full not in (BLOCK, REJECT, DROP_OLDEST):
            raise InvalidArgument(f'on_full is {self.on_full!r}; write "block", "reject" or "drop_oldest"')

    @property
    def payload_bytes_max(self) -> int:
        """The greatest payload that the queue accepts. It is below 0 if the queue accepts no message."""
        return min(self.max_item_bytes, self.max_bytes - ITEM_OVERHEAD_BYTES)
