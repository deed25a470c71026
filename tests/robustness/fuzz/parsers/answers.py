"""Answers of services, as clients read them.

If a client cannot read an answer of a hostile or newer service, it raises an error of the product.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from google.protobuf.message import Message

from stampede_rt.errors import StampedeError
from stampede_rt.status import DETAILS_KEY, encode_status, from_error_message, from_rpc_error
from stampede_rt.v1 import (
    channel_pb2,
    channel_service_pb2,
    directory_pb2,
    error_pb2,
    group_pb2,
    item_pb2,
    peer_pb2,
    queue_pb2,
    rpc_status_pb2,
)
from stampede_rt.wire import groups, peers, queues, reads, records
from stampede_rt.wire.decoding import ItemDecoder
from stampede_rt.wire.long_answers import LongRun
from tests.robustness.fuzz import hostile_values
from tests.robustness.fuzz.drawing import ByteSource
from tests.robustness.fuzz.messages import KnownValues, damaged, drawn_message
from tests.robustness.fuzz.parsers.target import Target

KNOWN = KnownValues()
_DECODER = ItemDecoder(incarnation=1, content_type="", payloads=True)
READERS: tuple[tuple[Callable[[Any], Any], type[Message]], ...] = (
    (records.policy_from_spec, channel_pb2.ChannelSpec),
    (records.host_info, directory_pb2.HostRecord),
    (records.supernode_info, directory_pb2.SupernodeRecord),
    (records.channel_stats, channel_pb2.ChannelStatus),
    (lambda message: records.channel_info(message, None), channel_pb2.ChannelRecord),
    (lambda message: records.change(message, {}), directory_pb2.DirectoryChange),
    (queues.queue_policy_from_spec, queue_pb2.QueueSpec),
    (lambda message: queues.queue_info(message, None), queue_pb2.QueueRecord),
    (queues.queue_stats, queue_pb2.QueueStatus),
    (queues.pending_message, queue_pb2.PendingDelivery),
    (groups.group_info, group_pb2.GroupRecord),
    (groups.member_status, group_pb2.GroupMemberStatus),
    (peers.peer_info, peer_pb2.PeerRecord),
    (peers.peer_change, peer_pb2.PeerChange),
    (reads.summary_reason, channel_service_pb2.GetSummary),
    (lambda message: _DECODER.decode([message, message]), item_pb2.DeliveredRun),
    (lambda message: [*map(list, _DECODER.decode_each([message]))], item_pb2.DeliveredRun),
    (
        lambda message: [*map(list, _DECODER.decode_long([LongRun(memoryview(message.SerializeToString()), 5)]))],
        item_pb2.ItemRun,
    ),
    (lambda message: list(queues.deliveries_of(message, "")), queue_pb2.LeasedRun),
)


def records_of_services(source: ByteSource) -> None:
    read, kind = source.choice(READERS)
    repr(read(drawn_message(source, kind.DESCRIPTOR, KNOWN)))


class _FailedCall(Exception):
    """An error as gRPC raises it for a failed call."""

    def __init__(self, code: Any, details: str | None, trailers: Any) -> None:
        self.code = lambda: code
        self.details = lambda: details
        self.trailing_metadata = lambda: trailers


def error(source: ByteSource) -> None:
    """Check that any status becomes an error of the product, with a printable text."""
    import grpc

    message = drawn_message(source, error_pb2.Error.DESCRIPTOR, KNOWN)
    raised = from_error_message(message)  # type: ignore[arg-type]
    encoded = encode_status(raised)
    if source.chance(50):
        encoded = drawn_message(source, rpc_status_pb2.Status.DESCRIPTOR, KNOWN).SerializeToString()
    if source.chance(50):
        encoded = damaged(source, encoded)
    trailers = ((DETAILS_KEY, encoded), ("other", hostile_values.text(source)))
    failed: Any = _FailedCall(source.choice(tuple(grpc.StatusCode)), hostile_values.text(source), trailers)
    assert str(from_rpc_error(failed, "localhost:1")) is not None
    assert isinstance(from_rpc_error(failed, "localhost:1"), StampedeError)


REFUSED = (StampedeError,)
TARGETS = (
    Target("records_of_services", records_of_services, REFUSED),
    Target("error", error, ()),
)
