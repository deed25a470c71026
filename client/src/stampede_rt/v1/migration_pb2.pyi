from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import group_pb2 as _group_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MoveState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MOVE_STATE_UNSPECIFIED: _ClassVar[MoveState]
    MOVE_STATE_PREPARED: _ClassVar[MoveState]
    MOVE_STATE_COMMITTED: _ClassVar[MoveState]
    MOVE_STATE_ABORTED: _ClassVar[MoveState]
MOVE_STATE_UNSPECIFIED: MoveState
MOVE_STATE_PREPARED: MoveState
MOVE_STATE_COMMITTED: MoveState
MOVE_STATE_ABORTED: MoveState

class MoveRecord(_message.Message):
    __slots__ = ("move_id", "subject", "from_host_id", "to_host_id", "to_boot_incarnation", "epoch", "last_seq", "state")
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    FROM_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    LAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    move_id: bytes
    subject: _subject_pb2.Subject
    from_host_id: bytes
    to_host_id: bytes
    to_boot_incarnation: int
    epoch: int
    last_seq: int
    state: MoveState
    def __init__(self, move_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., from_host_id: _Optional[bytes] = ..., to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., epoch: _Optional[int] = ..., last_seq: _Optional[int] = ..., state: _Optional[_Union[MoveState, str]] = ...) -> None: ...

class HandoffRecord(_message.Message):
    __slots__ = ("incarnation", "last_seq", "channel_counters", "queue_counters", "frontier_unix_nano", "newest_collected_unix_nano", "advance_unix_nano", "host_time_unix_nano", "cut_floors", "producers", "consumers", "queue_items", "settled", "next_delivery_id", "held", "message_ids")
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    LAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_COUNTERS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_COUNTERS_FIELD_NUMBER: _ClassVar[int]
    FRONTIER_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NEWEST_COLLECTED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CUT_FLOORS_FIELD_NUMBER: _ClassVar[int]
    PRODUCERS_FIELD_NUMBER: _ClassVar[int]
    CONSUMERS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ITEMS_FIELD_NUMBER: _ClassVar[int]
    SETTLED_FIELD_NUMBER: _ClassVar[int]
    NEXT_DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_IDS_FIELD_NUMBER: _ClassVar[int]
    incarnation: int
    last_seq: int
    channel_counters: _channel_pb2.ChannelCounters
    queue_counters: _queue_pb2.QueueCounters
    frontier_unix_nano: int
    newest_collected_unix_nano: int
    advance_unix_nano: int
    host_time_unix_nano: int
    cut_floors: _containers.RepeatedCompositeFieldContainer[_group_pb2.CutFloor]
    producers: _containers.RepeatedCompositeFieldContainer[ProducerWindow]
    consumers: _containers.RepeatedCompositeFieldContainer[ConsumerSlot]
    queue_items: _containers.RepeatedCompositeFieldContainer[QueueItemState]
    settled: _containers.RepeatedCompositeFieldContainer[SettledDelivery]
    next_delivery_id: int
    held: _containers.RepeatedCompositeFieldContainer[_subject_pb2.SeqRange]
    message_ids: _containers.RepeatedCompositeFieldContainer[KnownMessageId]
    def __init__(self, incarnation: _Optional[int] = ..., last_seq: _Optional[int] = ..., channel_counters: _Optional[_Union[_channel_pb2.ChannelCounters, _Mapping]] = ..., queue_counters: _Optional[_Union[_queue_pb2.QueueCounters, _Mapping]] = ..., frontier_unix_nano: _Optional[int] = ..., newest_collected_unix_nano: _Optional[int] = ..., advance_unix_nano: _Optional[int] = ..., host_time_unix_nano: _Optional[int] = ..., cut_floors: _Optional[_Iterable[_Union[_group_pb2.CutFloor, _Mapping]]] = ..., producers: _Optional[_Iterable[_Union[ProducerWindow, _Mapping]]] = ..., consumers: _Optional[_Iterable[_Union[ConsumerSlot, _Mapping]]] = ..., queue_items: _Optional[_Iterable[_Union[QueueItemState, _Mapping]]] = ..., settled: _Optional[_Iterable[_Union[SettledDelivery, _Mapping]]] = ..., next_delivery_id: _Optional[int] = ..., held: _Optional[_Iterable[_Union[_subject_pb2.SeqRange, _Mapping]]] = ..., message_ids: _Optional[_Iterable[_Union[KnownMessageId, _Mapping]]] = ...) -> None: ...

class ProducerWindow(_message.Message):
    __slots__ = ("producer_id", "ranges", "idle_nanos")
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    RANGES_FIELD_NUMBER: _ClassVar[int]
    IDLE_NANOS_FIELD_NUMBER: _ClassVar[int]
    producer_id: int
    ranges: _containers.RepeatedCompositeFieldContainer[NumberRange]
    idle_nanos: int
    def __init__(self, producer_id: _Optional[int] = ..., ranges: _Optional[_Iterable[_Union[NumberRange, _Mapping]]] = ..., idle_nanos: _Optional[int] = ...) -> None: ...

class NumberRange(_message.Message):
    __slots__ = ("first_number", "items", "first_seq", "stamped_unix_nano", "continues_run", "error", "answered_ago_nanos", "unjudged_items")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMPED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CONTINUES_RUN_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    ANSWERED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    UNJUDGED_ITEMS_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    items: int
    first_seq: int
    stamped_unix_nano: int
    continues_run: bool
    error: _error_pb2.Error
    answered_ago_nanos: int
    unjudged_items: int
    def __init__(self, first_number: _Optional[int] = ..., items: _Optional[int] = ..., first_seq: _Optional[int] = ..., stamped_unix_nano: _Optional[int] = ..., continues_run: bool = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ..., answered_ago_nanos: _Optional[int] = ..., unjudged_items: _Optional[int] = ...) -> None: ...

class ConsumerSlot(_message.Message):
    __slots__ = ("consumer_id", "lease_nanos", "consumed_below_seq", "consumed")
    CONSUMER_ID_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_BELOW_SEQ_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    consumer_id: int
    lease_nanos: int
    consumed_below_seq: int
    consumed: _containers.RepeatedCompositeFieldContainer[_subject_pb2.SeqRange]
    def __init__(self, consumer_id: _Optional[int] = ..., lease_nanos: _Optional[int] = ..., consumed_below_seq: _Optional[int] = ..., consumed: _Optional[_Iterable[_Union[_subject_pb2.SeqRange, _Mapping]]] = ...) -> None: ...

class QueueItemState(_message.Message):
    __slots__ = ("seq", "deliveries", "acknowledged_taker_ids", "leases", "delay_nanos", "last_failed_delivery")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_TAKER_IDS_FIELD_NUMBER: _ClassVar[int]
    LEASES_FIELD_NUMBER: _ClassVar[int]
    DELAY_NANOS_FIELD_NUMBER: _ClassVar[int]
    LAST_FAILED_DELIVERY_FIELD_NUMBER: _ClassVar[int]
    seq: int
    deliveries: _containers.RepeatedScalarFieldContainer[int]
    acknowledged_taker_ids: _containers.RepeatedScalarFieldContainer[int]
    leases: _containers.RepeatedCompositeFieldContainer[QueueLease]
    delay_nanos: int
    last_failed_delivery: FailedDelivery
    def __init__(self, seq: _Optional[int] = ..., deliveries: _Optional[_Iterable[int]] = ..., acknowledged_taker_ids: _Optional[_Iterable[int]] = ..., leases: _Optional[_Iterable[_Union[QueueLease, _Mapping]]] = ..., delay_nanos: _Optional[int] = ..., last_failed_delivery: _Optional[_Union[FailedDelivery, _Mapping]] = ...) -> None: ...

class FailedDelivery(_message.Message):
    __slots__ = ("deliveries", "taker_id", "taker_name", "end", "reason")
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    END_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    deliveries: int
    taker_id: int
    taker_name: str
    end: _item_pb2.DeliveryEnd
    reason: str
    def __init__(self, deliveries: _Optional[int] = ..., taker_id: _Optional[int] = ..., taker_name: _Optional[str] = ..., end: _Optional[_Union[_item_pb2.DeliveryEnd, str]] = ..., reason: _Optional[str] = ...) -> None: ...

class KnownMessageId(_message.Message):
    __slots__ = ("message_id", "seq", "accepted_ago_nanos")
    MESSAGE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    message_id: str
    seq: int
    accepted_ago_nanos: int
    def __init__(self, message_id: _Optional[str] = ..., seq: _Optional[int] = ..., accepted_ago_nanos: _Optional[int] = ...) -> None: ...

class QueueLease(_message.Message):
    __slots__ = ("delivery_id", "taker_id", "lease_nanos", "leased_ago_nanos", "taker_name")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    LEASED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    taker_id: int
    lease_nanos: int
    leased_ago_nanos: int
    taker_name: str
    def __init__(self, delivery_id: _Optional[int] = ..., taker_id: _Optional[int] = ..., lease_nanos: _Optional[int] = ..., leased_ago_nanos: _Optional[int] = ..., taker_name: _Optional[str] = ...) -> None: ...

class SettledDelivery(_message.Message):
    __slots__ = ("delivery_id", "taker_id", "settled_ago_nanos")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    SETTLED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    taker_id: int
    settled_ago_nanos: int
    def __init__(self, delivery_id: _Optional[int] = ..., taker_id: _Optional[int] = ..., settled_ago_nanos: _Optional[int] = ...) -> None: ...
