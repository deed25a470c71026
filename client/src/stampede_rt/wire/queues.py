"""Converts queues, their counters and their deliveries to and from protobuf messages (`queue.proto`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import accumulate, pairwise

from stampede_rt.v1 import directory_pb2, item_pb2, queue_pb2
from stampede_rt.values.model import OnFull
from stampede_rt.values.queueing import DeadLetterOrigin, PendingMessage, QueueInfo, QueuePolicy, QueueStats
from stampede_rt.wire.delivered import check_delivered, malformed
from stampede_rt.wire.records import ack_from_wire, ack_to_wire, copy_stats

_ON_FULL: dict[OnFull, queue_pb2.QueueOnFull] = {
    "block": queue_pb2.QUEUE_ON_FULL_BLOCK,
    "reject": queue_pb2.QUEUE_ON_FULL_REJECT,
    "drop_oldest": queue_pb2.QUEUE_ON_FULL_DROP_OLDEST,
}
_FROM_ON_FULL = {value: key for key, value in _ON_FULL.items()}
_OPTIONAL = (
    "max_items", "max_bytes", "copies", "lease_nanos", "max_deliveries", "dead_letter_queue_id", "content_type",
    "max_item_bytes", "replicas", "min_replicas",
)  # fmt: skip
_COUNTED = (
    "accepted", "held", "leased", "consumed", "dropped", "dead_lettered", "expelled", "delivered", "given_back",
    "leases_expired", "terminated", "duplicates", "accepted_bytes", "held_bytes",
)  # fmt: skip
_ENDS = {
    item_pb2.DELIVERY_END_LEASE_EXPIRED: "lease_expired",
    item_pb2.DELIVERY_END_GIVEN_BACK: "given_back",
    item_pb2.DELIVERY_END_TERMINATED: "terminated",
}
REJECTED_REASONS = ("full", "too_large", "malformed", "overloaded")


def queue_policy_to_spec(policy: QueuePolicy) -> queue_pb2.QueueSpec:
    """Return the message for a queue's policy. A setting that was not stated stays unset."""
    stated = {name: getattr(policy, name) for name in _OPTIONAL}
    on_full = _ON_FULL[policy.on_full] if policy.on_full else queue_pb2.QUEUE_ON_FULL_UNSPECIFIED
    return queue_pb2.QueueSpec(on_full=on_full, ack=ack_to_wire(policy.ack), **stated)


def queue_policy_from_spec(spec: queue_pb2.QueueSpec) -> QueuePolicy:
    """Return a queue's policy, from its message. A setting that was not stated is None."""
    stated = {name: getattr(spec, name) for name in _OPTIONAL if spec.HasField(name)}
    return QueuePolicy(on_full=_FROM_ON_FULL.get(spec.on_full), ack=ack_from_wire(spec.ack), **stated)


def queue_info(record: queue_pb2.QueueRecord, host: directory_pb2.HostRecord | None) -> QueueInfo:
    """Return a queue, as callers see it. `host` is its owner, or None if the directory no longer knows that host."""
    return QueueInfo(
        queue_id=record.queue_id,
        name=record.name,
        host_id=record.host_id,
        host=host.name if host else "",
        host_alive=bool(host and host.alive),
        epoch=record.epoch,
        incarnation=record.incarnation,
        policy=queue_policy_from_spec(record.spec),
        spec_version=record.spec_version,
        mailbox_of=record.mailbox_peer_id if record.HasField("mailbox_peer_id") else None,
        created_by=record.created_by,
    )


def queue_stats(status: queue_pb2.QueueStatus) -> QueueStats:
    """Return a queue's counters, as callers see them."""
    counters = status.counters
    return QueueStats(
        **{name: getattr(counters, name) for name in _COUNTED},
        rejected={reason: getattr(counters, f"rejected_{reason}") for reason in REJECTED_REASONS},
        waiting_gets=status.waiting_takers,
        waiting_puts=status.waiting_enqueues,
        oldest=status.oldest_accepted_unix_nano if status.HasField("oldest_accepted_unix_nano") else None,
        incarnation=status.record.incarnation,
        host_time=status.host_time_unix_nano,
        policy=queue_policy_from_spec(status.record.spec),
        replicas=tuple(map(copy_stats, status.fed_copies)),
    )


@dataclass(frozen=True, slots=True)
class DeliveredMessage:
    """One message as the host delivered it to this taker."""

    delivery_id: int
    seq: int
    time: int
    payload: bytes
    attributes: dict[str, str]
    content_type: str
    deliveries: int
    lease_nanos: int
    origin: DeadLetterOrigin | None


def deliveries_of(leased: queue_pb2.LeasedRun, content_type: str) -> Iterator[DeliveredMessage]:
    """Yield the deliveries of a leased run, one for each message.

    `content_type` is the content type of the queue. A run without a content type gets it. Raises StampedeError if the
    columns disagree.
    """
    run = leased.run
    items = check_delivered(run, payloads=True)
    if len(leased.delivery_ids) != items or len(leased.deliveries) not in (0, items):
        raise malformed(f"{items} items, {len(leased.delivery_ids)} delivery ids and {len(leased.deliveries)} counts")
    counts = leased.deliveries or (1,) * len(run.payload_length_bytes)
    origin = _origin(run.origin) if run.HasField("origin") else None
    bounds = pairwise(accumulate(run.payload_length_bytes, initial=0))
    columns = zip(leased.delivery_ids, run.time_unix_nano, bounds, counts, strict=True)
    for offset, (delivery_id, time, (start, end), count) in enumerate(columns):
        yield DeliveredMessage(
            delivery_id=delivery_id,
            seq=run.first_seq + offset,
            time=time,
            payload=run.payloads[start:end],
            attributes=dict(run.attributes),
            content_type=run.content_type or content_type,
            deliveries=count,
            lease_nanos=leased.lease_nanos,
            origin=origin,
        )


def _origin(origin: item_pb2.DeadLetterOrigin) -> DeadLetterOrigin:
    return DeadLetterOrigin(
        queue=origin.queue_name,
        queue_id=origin.queue_id,
        seq=origin.seq,
        incarnation=origin.incarnation,
        enqueued=origin.enqueued_unix_nano,
        deliveries=origin.deliveries,
        ended=_ENDS.get(origin.last_end, ""),
        reason=origin.reason,
        taker=origin.last_taker_name,
        taker_id=origin.last_taker_id,
    )


def pending_message(pending: queue_pb2.PendingDelivery) -> PendingMessage:
    """Return a pending message, as callers see it."""
    return PendingMessage(
        seq=pending.seq,
        taker=pending.taker_name,
        taker_id=pending.taker_id,
        deliveries=pending.deliveries,
        leased=pending.leased_unix_nano,
        expires=pending.expires_unix_nano,
    )
