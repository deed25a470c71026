from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import channel_service_pb2 as _channel_service_pb2
from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import replica_service_pb2 as _replica_service_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RawPutRequest(_message.Message):
    __slots__ = ("channel_id", "epoch", "producer_id", "puts", "piece")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    PUTS_FIELD_NUMBER: _ClassVar[int]
    PIECE_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    producer_id: int
    puts: _containers.RepeatedCompositeFieldContainer[RawPutRun]
    piece: _channel_service_pb2.RequestPiece
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., producer_id: _Optional[int] = ..., puts: _Optional[_Iterable[_Union[RawPutRun, _Mapping]]] = ..., piece: _Optional[_Union[_channel_service_pb2.RequestPiece, _Mapping]] = ...) -> None: ...

class RawPutRun(_message.Message):
    __slots__ = ("first_number", "wait_nanos", "run", "ack")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    wait_nanos: int
    run: bytes
    ack: _channel_pb2.Ack
    def __init__(self, first_number: _Optional[int] = ..., wait_nanos: _Optional[int] = ..., run: _Optional[bytes] = ..., ack: _Optional[_Union[_channel_pb2.Ack, str]] = ...) -> None: ...

class RawEnqueueRequest(_message.Message):
    __slots__ = ("queue_id", "epoch", "producer_id", "runs", "piece")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    PIECE_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    producer_id: int
    runs: _containers.RepeatedCompositeFieldContainer[RawEnqueueRun]
    piece: _channel_service_pb2.RequestPiece
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., producer_id: _Optional[int] = ..., runs: _Optional[_Iterable[_Union[RawEnqueueRun, _Mapping]]] = ..., piece: _Optional[_Union[_channel_service_pb2.RequestPiece, _Mapping]] = ...) -> None: ...

class RawEnqueueRun(_message.Message):
    __slots__ = ("first_number", "wait_nanos", "run", "message_id", "origin")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_ID_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    wait_nanos: int
    run: bytes
    message_id: str
    origin: bytes
    def __init__(self, first_number: _Optional[int] = ..., wait_nanos: _Optional[int] = ..., run: _Optional[bytes] = ..., message_id: _Optional[str] = ..., origin: _Optional[bytes] = ...) -> None: ...

class RawDeliveredRun(_message.Message):
    __slots__ = ("run", "next_time_unix_nano")
    RUN_FIELD_NUMBER: _ClassVar[int]
    NEXT_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    run: bytes
    next_time_unix_nano: int
    def __init__(self, run: _Optional[bytes] = ..., next_time_unix_nano: _Optional[int] = ...) -> None: ...

class RawGetResponse(_message.Message):
    __slots__ = ("call_id", "runs", "summary", "error")
    CALL_ID_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    call_id: int
    runs: _containers.RepeatedCompositeFieldContainer[RawDeliveredRun]
    summary: _channel_service_pb2.GetSummary
    error: _error_pb2.Error
    def __init__(self, call_id: _Optional[int] = ..., runs: _Optional[_Iterable[_Union[RawDeliveredRun, _Mapping]]] = ..., summary: _Optional[_Union[_channel_service_pb2.GetSummary, _Mapping]] = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ...) -> None: ...

class RawSubscribeResponse(_message.Message):
    __slots__ = ("opened", "gap", "runs", "progress")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    GAP_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    opened: _channel_service_pb2.SubscriptionOpened
    gap: _channel_service_pb2.SubscriptionGap
    runs: _containers.RepeatedCompositeFieldContainer[RawDeliveredRun]
    progress: _channel_service_pb2.SubscriptionProgress
    def __init__(self, opened: _Optional[_Union[_channel_service_pb2.SubscriptionOpened, _Mapping]] = ..., gap: _Optional[_Union[_channel_service_pb2.SubscriptionGap, _Mapping]] = ..., runs: _Optional[_Iterable[_Union[RawDeliveredRun, _Mapping]]] = ..., progress: _Optional[_Union[_channel_service_pb2.SubscriptionProgress, _Mapping]] = ...) -> None: ...

class RawFeedResponse(_message.Message):
    __slots__ = ("opened", "state", "runs", "move_over")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    MOVE_OVER_FIELD_NUMBER: _ClassVar[int]
    opened: _replica_service_pb2.FeedOpened
    state: _replica_service_pb2.FeedState
    runs: _containers.RepeatedCompositeFieldContainer[RawDeliveredRun]
    move_over: bool
    def __init__(self, opened: _Optional[_Union[_replica_service_pb2.FeedOpened, _Mapping]] = ..., state: _Optional[_Union[_replica_service_pb2.FeedState, _Mapping]] = ..., runs: _Optional[_Iterable[_Union[RawDeliveredRun, _Mapping]]] = ..., move_over: bool = ...) -> None: ...
