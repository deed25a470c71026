"""Queues and mailboxes as their users hold them (paper, section 3.5). Pure.

Instants are int nanoseconds since the epoch, durations int nanoseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import OnFull
from stampede_rt.values.policy import content_type_of, count_of, duration_of
from stampede_rt.values.timeline import DurationLike

ON_FULL = ("block", "reject", "drop_oldest")
LEASE_NANOS_MAX = 3_600_000_000_000
LEASE_NANOS_DEFAULT = 30_000_000_000  # of a queue that states none
DELAY_NANOS_MAX = 2**63 - 1
PREFETCH_MAX = 1024
MESSAGE_ID_BYTES_MAX = 128
REASON_BYTES_MAX = 1024


@dataclass(frozen=True, kw_only=True, slots=True)
class QueuePolicy:
    """How a queue is set up; None: never stated."""

    max_items: int | None = None
    max_bytes: int | None = None
    on_full: OnFull | None = None
    copies: int | None = None
    lease_nanos: int | None = None
    max_deliveries: int | None = None
    dead_letter_queue_id: bytes | None = None
    content_type: str | None = None
    max_item_bytes: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueInfo:
    """A queue as the directory knows it. A mailbox has no name of its own; `mailbox_of` is its peer's id."""

    queue_id: bytes
    name: str
    host_id: bytes
    host: str
    host_alive: bool
    epoch: int
    incarnation: int
    policy: QueuePolicy
    spec_version: int
    mailbox_of: bytes | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueStats:
    """A queue's counters, taken at one moment.

    `accepted == held + consumed + dropped + dead_lettered + expelled`, always. `leased` of the held ones are in the
    hands of takers. `delivered` counts repeated deliveries, too; `given_back`, `leases_expired` and `terminated` those
    that ended without an acknowledgement. `duplicates` are puts of a message id that was known. `rejected` is by
    reason. `oldest`: when the oldest held item was accepted.
    """

    accepted: int
    held: int
    leased: int
    consumed: int
    dropped: int
    dead_lettered: int
    expelled: int
    delivered: int
    given_back: int
    leases_expired: int
    terminated: int
    duplicates: int
    rejected: Mapping[str, int]
    accepted_bytes: int
    held_bytes: int
    waiting_gets: int
    waiting_puts: int
    oldest: int | None
    incarnation: int
    host_time: int
    policy: QueuePolicy = field(default_factory=QueuePolicy)


class Enqueued(NamedTuple):
    """Where a queue has an item: its `seq`, which compares within one `incarnation` of the queue.

    `duplicate`: an item was put under the same message id before; `seq` is that one's, and nothing was put now.
    """

    seq: int
    duplicate: bool
    incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class PendingMessage:
    """A message in the hands of a taker. `taker` is what people know that one by: its peer's name, or its machine and
    process; `taker_id` is the handle's, and unique. `deliveries` says which delivery of the message it is, from 1."""

    seq: int
    taker: str
    taker_id: int
    deliveries: int
    leased: int
    expires: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DeadLetterOrigin:
    """Where a dead letter comes from: the queue that it left, and how its last delivery there ended.

    `queue` is that queue's name, empty for a mailbox; `enqueued` when it was accepted there; `deliveries` how often it
    was delivered. `ended` is "lease_expired", "given_back", "terminated", or empty if that is not known; `reason` what
    its last taker said; `taker` and `taker_id` as in PendingMessage.
    """

    queue: str
    queue_id: bytes
    seq: int
    incarnation: int
    enqueued: int
    deliveries: int
    ended: str
    reason: str
    taker: str
    taker_id: int


def parse_message_id(value: str | None) -> str:
    """What a message is recognised by; None: nothing. Raises InvalidArgument."""
    if value is None:
        return ""
    if not isinstance(value, str) or not 0 < len(value.encode()) <= MESSAGE_ID_BYTES_MAX:
        raise InvalidArgument(f"message_id is {value!r}; give 1 to {MESSAGE_ID_BYTES_MAX} bytes of text")
    return value


def parse_reason(value: str | None) -> str:
    """Why a message is given up; None: nothing is said. Raises InvalidArgument."""
    if value is not None and not (isinstance(value, str) and len(value.encode()) <= REASON_BYTES_MAX):
        raise InvalidArgument(f"reason is {value!r}; give text of {REASON_BYTES_MAX} bytes at most")
    return value or ""


def parse_queue_policy(
    *,
    max_items: int | None = None,
    max_bytes: int | None = None,
    copies: int | None = None,
    on_full: OnFull | None = None,
    lease: DurationLike | None = None,
    max_deliveries: int | None = None,
    dead_letter_queue_id: bytes | None = None,
    content_type: str | None = None,
) -> QueuePolicy:
    """The stated set-up; None stands for not stated. Raises InvalidArgument, naming the argument."""
    if on_full is not None and on_full not in ON_FULL:
        raise InvalidArgument(f"on_full is {on_full!r}; write one of {', '.join(map(repr, ON_FULL))}")
    return QueuePolicy(
        max_items=count_of("max_items", max_items),
        max_bytes=count_of("max_bytes", max_bytes),
        on_full=on_full,
        copies=count_of("copies", copies),
        lease_nanos=parse_lease(lease),
        max_deliveries=count_of("max_deliveries", max_deliveries),
        dead_letter_queue_id=dead_letter_queue_id,
        content_type=content_type_of(content_type),
    )


def parse_lease(value: DurationLike | None) -> int | None:
    """A lease in nanoseconds: more than 0, at most one hour; None as it is."""
    nanos = duration_of("lease", value, least=1)
    if nanos is not None and nanos > LEASE_NANOS_MAX:
        raise InvalidArgument(f"lease is {value!r}; it is 1 h at most: extend it while you work")
    return nanos


def parse_prefetch(value: int) -> int:
    """How many messages may be under way to one handle."""
    count = count_of("prefetch", value)
    if count is None or count > PREFETCH_MAX:
        raise InvalidArgument(f"prefetch is {value!r}; it is 1 to {PREFETCH_MAX}")
    return count
