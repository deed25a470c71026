"""The values that users of queues and mailboxes get (paper, section 3.5). Pure.

Instants are int nanoseconds since the epoch, durations int nanoseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.model import Ack, OnFull
from stampede_rt.values.payloads import text_length_bytes
from stampede_rt.values.policy import content_type_of, count_of, duration_of, max_bytes_of, replicas_of
from stampede_rt.values.proxying import CopyStats
from stampede_rt.values.timeline import DurationLike

ON_FULL = ("block", "reject", "drop_oldest")
LEASE_NANOS_MAX = 3_600_000_000_000  # one hour
LEASE_NANOS_DEFAULT = 30_000_000_000  # the lease of a queue whose policy states none
DELAY_NANOS_MAX = 2**63 - 1  # for the `delay` of `Message.nack`
PREFETCH_MAX = 1024  # messages
MESSAGE_ID_BYTES_MAX = 128
REASON_BYTES_MAX = 1024  # for the `reason` of `Message.term`


@dataclass(frozen=True, kw_only=True, slots=True)
class QueuePolicy:
    """The policy of a queue (see `Connection.queue`). None: the setting was not stated."""

    max_items: int | None = None
    max_bytes: int | None = None
    on_full: OnFull | None = None
    copies: int | None = None
    lease_nanos: int | None = None
    max_deliveries: int | None = None
    dead_letter_queue_id: bytes | None = None
    content_type: str | None = None
    max_item_bytes: int | None = None
    replicas: int | None = None
    ack: Ack | None = None
    min_replicas: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueInfo:
    """A queue or mailbox as the directory knows it.

    The `name` of a mailbox is empty, and `mailbox_of` is the id of its peer. `created_by` is as in ChannelInfo. It is
    empty for a mailbox; the mailbox's peer has an `owner`.
    """

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
    created_by: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueStats:
    """A queue's counters at one moment: `accepted == held + consumed + dropped + dead_lettered + expelled`, always.

    - `leased`: the held messages that are leased to at least one taker.
    - `dropped`: messages that on_full="drop_oldest" removed. `expelled`: messages that reached max_deliveries, or that
      a taker gave up, in a queue without a dead-letter queue.
    - `delivered`: all deliveries, also repeated ones. `given_back`, `leases_expired` and `terminated` count the
      deliveries that ended without an acknowledgement: the taker gave the message back, its lease ended, or the taker
      gave the message up.
    - `duplicates`: puts with a message id that the queue already knew. `rejected`: refused puts, by reason.
    - `oldest`: the time at which the queue accepted the oldest held message.
    - `replicas`: the replicas, as the owner feeds them. Their `waiting` counts changes of the queue.
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
    replicas: tuple[CopyStats, ...] = ()


class Enqueued(NamedTuple):
    """The place of an accepted message: its `seq` within one `incarnation` of the queue.

    `duplicate` is True if the queue has accepted a message with the same message id before. It then stores nothing, and
    `seq` is the seq of the earlier message. `copies` is the number of hosts that have the message and may become the
    owner; 1 without replicas.
    """

    seq: int
    duplicate: bool
    incarnation: int
    copies: int = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class PendingMessage:
    """A message that is leased to a taker and not yet settled.

    `taker` is the peer name of the taker's connection, or its machine and process if the connection has no name.
    `taker_id` is a number of the taker's handle. No other handle has it. `deliveries` counts the deliveries of this
    message, from 1. `leased` and `expires` are the instants at which the lease began and at which it ends.
    """

    seq: int
    taker: str
    taker_id: int
    deliveries: int
    leased: int
    expires: int


@dataclass(frozen=True, kw_only=True, slots=True)
class DeadLetterOrigin:
    """The queue that a dead letter left, and how its last delivery there ended.

    `queue` is the name of that queue, or empty for a mailbox. `seq` and `incarnation` are the message's seq and
    incarnation there. `enqueued` is the time at which that queue accepted the message. `deliveries` counts the
    deliveries from that queue. `ended` is "lease_expired", "given_back" or "terminated", or empty if unknown. `reason`
    is the text that the last taker gave to `Message.term`. `taker` and `taker_id` name the last taker, as in
    PendingMessage.
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
    """Return the message id; an empty text if it is None.

    Raises InvalidArgument unless it has 1 to 128 bytes in UTF-8.
    """
    if value is None:
        return ""
    if not 0 < (text_length_bytes(value) or 0) <= MESSAGE_ID_BYTES_MAX:
        raise InvalidArgument(f"message_id is {value!r:.300}; give 1 to {MESSAGE_ID_BYTES_MAX} bytes of text")
    return value


def parse_reason(value: str | None) -> str:
    """Return the text of a taker that gives a message up; an empty text if it is None.

    Raises InvalidArgument if it has more than REASON_BYTES_MAX bytes in UTF-8.
    """
    if value is None:
        return ""
    length_bytes = text_length_bytes(value)
    if length_bytes is None or length_bytes > REASON_BYTES_MAX:
        raise InvalidArgument(f"reason is {value!r:.100}; give text of at most {REASON_BYTES_MAX} bytes")
    return value


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
    replicas: int | None = None,
    ack: Ack | None = None,
    min_replicas: int | None = None,
) -> QueuePolicy:
    """Return the policy that the arguments state. An argument that is None is not stated.

    Raises InvalidArgument, which names the wrong argument.
    """
    if on_full is not None and on_full not in ON_FULL:
        raise InvalidArgument(f"on_full is {on_full!r}; write one of {', '.join(map(repr, ON_FULL))}")
    return QueuePolicy(
        max_items=count_of("max_items", max_items),
        max_bytes=max_bytes_of(max_bytes),
        on_full=on_full,
        copies=count_of("copies", copies, below=2**32),
        lease_nanos=parse_lease(lease),
        max_deliveries=count_of("max_deliveries", max_deliveries, below=2**32),
        dead_letter_queue_id=dead_letter_queue_id,
        content_type=content_type_of(content_type),
        replicas=replicas_of("replicas", replicas),
        ack=_ack_of(ack),
        min_replicas=replicas_of("min_replicas", min_replicas),
    )


def _ack_of(ack: Ack | None) -> Ack | None:
    if ack not in (None, "host", "replica"):
        raise InvalidArgument(f'ack is {ack!r}; the ack of a queue is "host" or "replica"')
    return ack


def parse_lease(value: DurationLike | None) -> int | None:
    """Return a lease in nanoseconds; None if `value` is None.

    Raises InvalidArgument unless the lease is more than 0 and at most one hour.
    """
    nanos = duration_of("lease", value, least=1)
    if nanos is not None and nanos > LEASE_NANOS_MAX:
        raise InvalidArgument(f"lease is {value!r}; give at most 1 h, and extend the lease while you work")
    return nanos


def parse_prefetch(value: int) -> int:
    """Return the number of messages that the host may send before callers ask for them. Raises InvalidArgument."""
    count = count_of("prefetch", value)
    if count is None or count > PREFETCH_MAX:
        raise InvalidArgument(f"prefetch is {value!r}; it must be 1 to {PREFETCH_MAX}")
    return count
