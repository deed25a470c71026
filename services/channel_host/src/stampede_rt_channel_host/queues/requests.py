"""Checks the requests of QueueService and turns them into the core's values."""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import InvalidArgument
from stampede_rt.status import to_error_message
from stampede_rt.v1 import queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.cluster.identity import ID_BYTES
from stampede_rt_channel_host.core.queue import (
    LEASE_NANOS_MAX,
    Acknowledge,
    Extend,
    GiveBack,
    PendingDelivery,
    Settlement,
    SettlementResult,
    TakerState,
    Terminate,
)

CREDIT_MAX = 1024  # the most credit of a taker, in messages
SETTLEMENTS_MAX = 1024
TAKER_NAME_BYTES_MAX = 128
REASON_BYTES_MAX = 1024
PAGE_SIZE_MAX = 1000


def check_queue_id(queue_id: bytes) -> None:
    """Raises InvalidArgument for an id of the wrong length."""
    if len(queue_id) != ID_BYTES:
        raise InvalidArgument(f"queue_id has {len(queue_id)} bytes; give the {ID_BYTES} bytes that the directory gave")


def check_taker_id(taker_id: int) -> None:
    """Raises InvalidArgument for the id 0."""
    if not taker_id:
        raise InvalidArgument("taker_id is 0; choose a random number above 0, and keep it")


def taker_of(opened: pb.TakeOpen) -> TakerState:
    """The taker of a request. Raises InvalidArgument for an invalid id, lease or name."""
    check_queue_id(opened.queue_id)
    check_taker_id(opened.taker_id)
    lease_nanos = opened.lease_nanos if opened.HasField("lease_nanos") else None
    if lease_nanos is not None:
        _check_lease(lease_nanos)
    if len(opened.taker_name.encode()) > TAKER_NAME_BYTES_MAX:
        raise InvalidArgument(f"taker_name has more than {TAKER_NAME_BYTES_MAX} bytes of UTF-8; shorten it")
    return TakerState(opened.taker_id, lease_nanos, opened.taker_name)


def settlements_of(messages: Iterable[queue_pb2.Settlement]) -> list[Settlement]:
    """The settlements of a request. Raises InvalidArgument if a settlement is invalid, or if there are too many."""
    settlements = [_settlement_of(message) for message in messages]
    if len(settlements) > SETTLEMENTS_MAX:
        raise InvalidArgument(
            f"the request holds {len(settlements)} settlements; the limit is {SETTLEMENTS_MAX}: send several requests"
        )
    return settlements


def page_size_of(request: pb.ListPendingRequest) -> int:
    """The number of deliveries that the request asks for. Raises InvalidArgument if it is above PAGE_SIZE_MAX."""
    if request.page_size > PAGE_SIZE_MAX:
        raise InvalidArgument(f"page_size is {request.page_size}; it is at most {PAGE_SIZE_MAX}")
    return request.page_size or PAGE_SIZE_MAX


def pending_message(one: PendingDelivery) -> queue_pb2.PendingDelivery:
    """The message of a leased delivery."""
    return queue_pb2.PendingDelivery(
        delivery_id=one.delivery_id,
        seq=one.seq,
        taker_id=one.taker_id,
        taker_name=one.taker_name,
        deliveries=one.number,
        leased_unix_nano=one.leased_at,
        expires_unix_nano=one.expires,
    )


def result_message(result: SettlementResult) -> queue_pb2.SettlementResult:
    """The message of the result of one settlement."""
    return queue_pb2.SettlementResult(
        delivery_id=result.delivery_id,
        error=to_error_message(result.error) if result.error else None,
        lease_nanos=result.lease_nanos,
    )


def _settlement_of(message: queue_pb2.Settlement) -> Settlement:
    verdict = message.WhichOneof("verdict")
    if not message.delivery_id or verdict is None:
        raise InvalidArgument("a settlement lacks delivery_id or verdict; set both")
    if verdict == "acknowledge":
        return Settlement(message.delivery_id, Acknowledge())
    if verdict == "give_back":
        delay_nanos = message.give_back.delay_nanos
        if delay_nanos < 0:
            raise InvalidArgument(f"delay_nanos is {delay_nanos}; it is 0 or more")
        return Settlement(message.delivery_id, GiveBack(delay_nanos, message.give_back.uncounted))
    if verdict == "terminate":
        reason = message.terminate.reason
        if len(reason.encode()) > REASON_BYTES_MAX:
            raise InvalidArgument(f"the reason has more than {REASON_BYTES_MAX} bytes of UTF-8; shorten it")
        return Settlement(message.delivery_id, Terminate(reason))
    _check_lease(message.extend_lease.lease_nanos)
    return Settlement(message.delivery_id, Extend(message.extend_lease.lease_nanos))


def _check_lease(lease_nanos: int) -> None:
    if not 0 < lease_nanos <= LEASE_NANOS_MAX:
        raise InvalidArgument(f"lease_nanos is {lease_nanos}; it is more than 0 and at most {LEASE_NANOS_MAX} (1 h)")
