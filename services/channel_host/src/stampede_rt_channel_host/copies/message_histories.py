"""Converts the histories of messages to and from the parts of a whole queue (see `queue_messages`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.core.queue import FailedDelivery, ItemState, LeaseState

COPIES_PER_ENTRY = 256
"""An entry has at most this many leases, each with the name of a taker: about 40 KiB."""
_CONTINUED = 0  # in place of a seq: the entry belongs to the message of the previous entry


def entries_of(items: Iterable[ItemState]) -> Iterator[pb.HandedMessage]:
    """The entries of messages. Each message has one entry, and further entries if it has many copies.

    A message may have as many leases as the queue has takers, and would then be too long for one part.
    """
    return chain.from_iterable(map(_entries_of, items))


def items_of(entries: Iterable[pb.HandedMessage]) -> Iterator[ItemState]:
    """The messages of `entries_of`. Raises InvalidArgument if the first entry continues another one."""
    item: ItemState | None = None
    for entry in entries:
        if entry.seq != _CONTINUED:
            if item is not None:
                yield item
            item = _item_of(entry)
        elif item is None:
            raise InvalidArgument(
                "the first entry of the handed queue continues no message; install the same release on both hosts"
            )
        else:
            item = _continued(item, entry)
    if item is not None:
        yield item


def _entries_of(item: ItemState) -> Iterator[pb.HandedMessage]:
    entry = pb.HandedMessage(
        seq=item.seq,
        delay_nanos=item.delay_nanos,
        is_leaving=item.is_leaving,
        last=None if item.last is None else pb.HandedFailure(**item.last._asdict()),
        is_change=item.ended is not None,
    )
    ended = item.ended or ()
    copies = max(1, len(item.deliveries), len(item.acknowledged), len(item.leases), len(ended))
    for at in range(0, copies, COPIES_PER_ENTRY):
        some = slice(at, at + COPIES_PER_ENTRY)
        entry.deliveries.extend(item.deliveries[some])
        entry.acknowledged.extend(item.acknowledged[some])
        entry.ended.extend(ended[some])
        entry.leases.extend(pb.HandedLease(**lease._asdict()) for lease in item.leases[some])
        yield entry
        entry = pb.HandedMessage(seq=_CONTINUED)


def _item_of(entry: pb.HandedMessage) -> ItemState:
    return ItemState(
        seq=entry.seq,
        deliveries=tuple(entry.deliveries),
        acknowledged=tuple(entry.acknowledged),
        leases=[*map(_lease_of, entry.leases)],
        delay_nanos=entry.delay_nanos,
        is_leaving=entry.is_leaving,
        last=_failure_of(entry.last) if entry.HasField("last") else None,
        ended=tuple(entry.ended) if entry.is_change else None,
    )


def _continued(item: ItemState, entry: pb.HandedMessage) -> ItemState:
    return item._replace(
        deliveries=(*item.deliveries, *entry.deliveries),
        acknowledged=(*item.acknowledged, *entry.acknowledged),
        leases=[*item.leases, *map(_lease_of, entry.leases)],
        ended=None if item.ended is None else (*item.ended, *entry.ended),
    )


def _lease_of(one: pb.HandedLease) -> LeaseState:
    return LeaseState(one.delivery_id, one.taker_id, one.taker_name, one.lease_nanos, one.leased_ago_nanos)


def _failure_of(last: pb.HandedFailure) -> FailedDelivery:
    return FailedDelivery(last.number, last.taker_id, last.taker_name, last.ended, last.reason)
