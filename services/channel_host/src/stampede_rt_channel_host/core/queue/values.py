"""The arguments and results of a queue's methods (paper, section 3.5). Pure.

Instants are int nanoseconds of the host's clock, durations int nanoseconds, sizes bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from stampede_rt.errors import StampedeError
from stampede_rt_channel_host.core.queue.items import FailedDelivery, QueuedRun


class SealRun(Protocol):
    """Makes the stored bytes of accepted messages. The function must not raise."""

    def __call__(self, first_seq: int, positions: Sequence[int], stamped_time: int | None) -> bytes:
        """The bytes to store.

        `positions` are the positions of the accepted messages in their run. `stamped_time` is the time that the queue
        gave them, or None if the run had times.
        """


class LeasedSlice(NamedTuple):
    """The messages of a run from position `lo` up to `hi`, exclusive, each with a delivery id and a delivery number.

    A number in `deliveries` counts the deliveries of this copy of the message (see the limit `copies`), from 1.
    """

    run: QueuedRun
    lo: int
    hi: int
    delivery_ids: Sequence[int]
    deliveries: Sequence[int]


class Batch(NamedTuple):
    """The messages that one taker gets at one moment. Their leases end at `expires`."""

    slices: Sequence[LeasedSlice]
    expires: int

    @property
    def items(self) -> int:
        """The number of deliveries."""
        return sum(one.hi - one.lo for one in self.slices)


@dataclass(frozen=True, slots=True)
class Acknowledge:
    """The taker is done with the message."""


@dataclass(frozen=True, slots=True)
class GiveBack:
    """The message returns to its position in the queue. The queue does not deliver it again for `delay_nanos`, 0 or
    more.

    `uncounted`: the taker's program never saw the message, so the delivery does not count towards max_deliveries.
    """

    delay_nanos: int = 0
    uncounted: bool = False


@dataclass(frozen=True, slots=True)
class Extend:
    """The lease lasts for `lease_nanos` from now on. `lease_nanos` is more than 0."""

    lease_nanos: int


@dataclass(frozen=True, slots=True)
class Terminate:
    """The taker gives the message up for all takers. The message leaves the queue. `reason` is a text for people."""

    reason: str = ""


Verdict = Acknowledge | GiveBack | Extend | Terminate


class Settlement(NamedTuple):
    """The decision of a taker about a delivery: it ends the delivery, or extends the lease."""

    delivery_id: int
    verdict: Verdict


class SettlementResult(NamedTuple):
    """The outcome of a settlement. `error` is None if the settlement succeeded.

    `lease_nanos` is the new length of the lease after an `Extend`, and otherwise None.
    """

    delivery_id: int
    error: StampedeError | None = None
    lease_nanos: int | None = None


class DeadLetter(NamedTuple):
    """The message at `position` of `run`, which waits for its move to the dead-letter queue.

    `last` is its last failed delivery, or None if no delivery failed.
    """

    seq: int
    run: QueuedRun
    position: int
    last: FailedDelivery | None


class PendingDelivery(NamedTuple):
    """A message that is leased to a taker. `number` counts the deliveries of this copy of it, from 1."""

    delivery_id: int
    seq: int
    taker_id: int
    taker_name: str
    number: int
    leased_at: int
    expires: int


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueCounters:
    """The counts of a queue. Always `accepted == held + consumed + dropped + dead_lettered + expelled`.

    `leased`: held messages with a lease. `consumed`: messages acknowledged by as many takers as `copies` says.
    `dropped`: messages removed to make room. `dead_lettered`: messages moved to the dead-letter queue. `expelled`:
    messages given up without a dead-letter queue. `duplicates`: messages not stored, because their message id was
    known. `delivered`, `given_back`, `leases_expired` and `terminated` count deliveries.
    """

    accepted: int = 0
    held: int = 0
    leased: int = 0
    consumed: int = 0
    dropped: int = 0
    dead_lettered: int = 0
    expelled: int = 0
    delivered: int = 0
    given_back: int = 0
    leases_expired: int = 0
    terminated: int = 0
    duplicates: int = 0
    rejected_full: int = 0
    rejected_too_large: int = 0
    rejected_malformed: int = 0
    rejected_overloaded: int = 0
    accepted_bytes: int = 0
    held_bytes: int = 0
