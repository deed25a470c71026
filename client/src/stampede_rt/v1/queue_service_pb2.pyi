from stampede_rt.v1 import channel_service_pb2 as _channel_service_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class EnqueueRequest(_message.Message):
    __slots__ = ("queue_id", "epoch", "producer_id", "runs", "piece")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    PIECE_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    producer_id: int
    runs: _containers.RepeatedCompositeFieldContainer[EnqueueRun]
    piece: _channel_service_pb2.RequestPiece
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., producer_id: _Optional[int] = ..., runs: _Optional[_Iterable[_Union[EnqueueRun, _Mapping]]] = ..., piece: _Optional[_Union[_channel_service_pb2.RequestPiece, _Mapping]] = ...) -> None: ...

class EnqueueRun(_message.Message):
    __slots__ = ("first_number", "wait_nanos", "run", "message_id", "origin")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_ID_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    wait_nanos: int
    run: _item_pb2.ItemRun
    message_id: str
    origin: _item_pb2.DeadLetterOrigin
    def __init__(self, first_number: _Optional[int] = ..., wait_nanos: _Optional[int] = ..., run: _Optional[_Union[_item_pb2.ItemRun, _Mapping]] = ..., message_id: _Optional[str] = ..., origin: _Optional[_Union[_item_pb2.DeadLetterOrigin, _Mapping]] = ...) -> None: ...

class EnqueueResponse(_message.Message):
    __slots__ = ("acks",)
    ACKS_FIELD_NUMBER: _ClassVar[int]
    acks: _containers.RepeatedCompositeFieldContainer[_channel_service_pb2.PutAck]
    def __init__(self, acks: _Optional[_Iterable[_Union[_channel_service_pb2.PutAck, _Mapping]]] = ...) -> None: ...

class TakeRequest(_message.Message):
    __slots__ = ("open", "credit", "settlements", "drain")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    CREDIT_FIELD_NUMBER: _ClassVar[int]
    SETTLEMENTS_FIELD_NUMBER: _ClassVar[int]
    DRAIN_FIELD_NUMBER: _ClassVar[int]
    open: TakeOpen
    credit: int
    settlements: _containers.RepeatedCompositeFieldContainer[_queue_pb2.Settlement]
    drain: bool
    def __init__(self, open: _Optional[_Union[TakeOpen, _Mapping]] = ..., credit: _Optional[int] = ..., settlements: _Optional[_Iterable[_Union[_queue_pb2.Settlement, _Mapping]]] = ..., drain: bool = ...) -> None: ...

class TakeOpen(_message.Message):
    __slots__ = ("queue_id", "epoch", "taker_id", "lease_nanos", "taker_name")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    taker_id: int
    lease_nanos: int
    taker_name: str
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., taker_id: _Optional[int] = ..., lease_nanos: _Optional[int] = ..., taker_name: _Optional[str] = ...) -> None: ...

class TakeResponse(_message.Message):
    __slots__ = ("runs", "results", "incarnation", "drained")
    RUNS_FIELD_NUMBER: _ClassVar[int]
    RESULTS_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    DRAINED_FIELD_NUMBER: _ClassVar[int]
    runs: _containers.RepeatedCompositeFieldContainer[_queue_pb2.LeasedRun]
    results: _containers.RepeatedCompositeFieldContainer[_queue_pb2.SettlementResult]
    incarnation: int
    drained: bool
    def __init__(self, runs: _Optional[_Iterable[_Union[_queue_pb2.LeasedRun, _Mapping]]] = ..., results: _Optional[_Iterable[_Union[_queue_pb2.SettlementResult, _Mapping]]] = ..., incarnation: _Optional[int] = ..., drained: bool = ...) -> None: ...

class SettleRequest(_message.Message):
    __slots__ = ("queue_id", "epoch", "taker_id", "settlements")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    SETTLEMENTS_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    taker_id: int
    settlements: _containers.RepeatedCompositeFieldContainer[_queue_pb2.Settlement]
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., taker_id: _Optional[int] = ..., settlements: _Optional[_Iterable[_Union[_queue_pb2.Settlement, _Mapping]]] = ...) -> None: ...

class SettleResponse(_message.Message):
    __slots__ = ("results",)
    RESULTS_FIELD_NUMBER: _ClassVar[int]
    results: _containers.RepeatedCompositeFieldContainer[_queue_pb2.SettlementResult]
    def __init__(self, results: _Optional[_Iterable[_Union[_queue_pb2.SettlementResult, _Mapping]]] = ...) -> None: ...

class ListPendingRequest(_message.Message):
    __slots__ = ("queue_id", "epoch", "after_delivery_id", "page_size")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    AFTER_DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    after_delivery_id: int
    page_size: int
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., after_delivery_id: _Optional[int] = ..., page_size: _Optional[int] = ...) -> None: ...

class ListPendingResponse(_message.Message):
    __slots__ = ("deliveries", "more")
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    deliveries: _containers.RepeatedCompositeFieldContainer[_queue_pb2.PendingDelivery]
    more: bool
    def __init__(self, deliveries: _Optional[_Iterable[_Union[_queue_pb2.PendingDelivery, _Mapping]]] = ..., more: bool = ...) -> None: ...

class GetQueueStatusRequest(_message.Message):
    __slots__ = ("queue_id", "epoch")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class GetQueueStatusResponse(_message.Message):
    __slots__ = ("status",)
    STATUS_FIELD_NUMBER: _ClassVar[int]
    status: _queue_pb2.QueueStatus
    def __init__(self, status: _Optional[_Union[_queue_pb2.QueueStatus, _Mapping]] = ...) -> None: ...
