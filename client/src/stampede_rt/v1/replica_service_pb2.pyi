from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from stampede_rt.v1 import replica_pb2 as _replica_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class StartReplicaRequest(_message.Message):
    __slots__ = ("request_id", "subject", "epoch", "kind", "source_host_id", "acknowledged")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SOURCE_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    subject: _subject_pb2.Subject
    epoch: int
    kind: _replica_pb2.ReplicaKind
    source_host_id: bytes
    acknowledged: bool
    def __init__(self, request_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., kind: _Optional[_Union[_replica_pb2.ReplicaKind, str]] = ..., source_host_id: _Optional[bytes] = ..., acknowledged: bool = ...) -> None: ...

class StartReplicaResponse(_message.Message):
    __slots__ = ("status",)
    STATUS_FIELD_NUMBER: _ClassVar[int]
    status: _replica_pb2.ReplicaStatus
    def __init__(self, status: _Optional[_Union[_replica_pb2.ReplicaStatus, _Mapping]] = ...) -> None: ...

class StopReplicaRequest(_message.Message):
    __slots__ = ("request_id", "subject")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    subject: _subject_pb2.Subject
    def __init__(self, request_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ...) -> None: ...

class StopReplicaResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class FeedRequest(_message.Message):
    __slots__ = ("open", "held_next_seq")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    HELD_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    open: FeedOpen
    held_next_seq: int
    def __init__(self, open: _Optional[_Union[FeedOpen, _Mapping]] = ..., held_next_seq: _Optional[int] = ...) -> None: ...

class FeedOpen(_message.Message):
    __slots__ = ("subject", "epoch", "host_id", "boot_incarnation", "kind", "after")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    epoch: int
    host_id: bytes
    boot_incarnation: int
    kind: _replica_pb2.ReplicaKind
    after: _item_pb2.ItemPosition
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., kind: _Optional[_Union[_replica_pb2.ReplicaKind, str]] = ..., after: _Optional[_Union[_item_pb2.ItemPosition, _Mapping]] = ...) -> None: ...

class FeedResponse(_message.Message):
    __slots__ = ("opened", "gap", "runs", "origins", "consumptions", "removed", "progress")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    GAP_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    ORIGINS_FIELD_NUMBER: _ClassVar[int]
    CONSUMPTIONS_FIELD_NUMBER: _ClassVar[int]
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    opened: FeedOpened
    gap: FeedGap
    runs: _containers.RepeatedCompositeFieldContainer[_item_pb2.DeliveredRun]
    origins: _containers.RepeatedCompositeFieldContainer[FeedOrigin]
    consumptions: _containers.RepeatedCompositeFieldContainer[FeedConsumption]
    removed: _containers.RepeatedCompositeFieldContainer[_subject_pb2.SeqRange]
    progress: FeedProgress
    def __init__(self, opened: _Optional[_Union[FeedOpened, _Mapping]] = ..., gap: _Optional[_Union[FeedGap, _Mapping]] = ..., runs: _Optional[_Iterable[_Union[_item_pb2.DeliveredRun, _Mapping]]] = ..., origins: _Optional[_Iterable[_Union[FeedOrigin, _Mapping]]] = ..., consumptions: _Optional[_Iterable[_Union[FeedConsumption, _Mapping]]] = ..., removed: _Optional[_Iterable[_Union[_subject_pb2.SeqRange, _Mapping]]] = ..., progress: _Optional[_Union[FeedProgress, _Mapping]] = ...) -> None: ...

class FeedOpened(_message.Message):
    __slots__ = ("channel", "queue", "next_seq")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    queue: _queue_pb2.QueueRecord
    next_seq: int
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., next_seq: _Optional[int] = ...) -> None: ...

class FeedGap(_message.Message):
    __slots__ = ("first_seq", "last_seq", "reason")
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    LAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    first_seq: int
    last_seq: int
    reason: _error_pb2.AbsenceReason
    def __init__(self, first_seq: _Optional[int] = ..., last_seq: _Optional[int] = ..., reason: _Optional[_Union[_error_pb2.AbsenceReason, str]] = ...) -> None: ...

class FeedOrigin(_message.Message):
    __slots__ = ("producer_id", "first_number", "first_seq", "items", "unjudged_items")
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    UNJUDGED_ITEMS_FIELD_NUMBER: _ClassVar[int]
    producer_id: int
    first_number: int
    first_seq: int
    items: int
    unjudged_items: int
    def __init__(self, producer_id: _Optional[int] = ..., first_number: _Optional[int] = ..., first_seq: _Optional[int] = ..., items: _Optional[int] = ..., unjudged_items: _Optional[int] = ...) -> None: ...

class FeedConsumption(_message.Message):
    __slots__ = ("consumer_id", "seqs")
    CONSUMER_ID_FIELD_NUMBER: _ClassVar[int]
    SEQS_FIELD_NUMBER: _ClassVar[int]
    consumer_id: int
    seqs: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, consumer_id: _Optional[int] = ..., seqs: _Optional[_Iterable[int]] = ...) -> None: ...

class FeedProgress(_message.Message):
    __slots__ = ("next_seq", "frontier_unix_nano", "advance_unix_nano", "channel_spec", "queue_spec", "spec_version", "host_time_unix_nano", "source_lag_nanos")
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    FRONTIER_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_SPEC_FIELD_NUMBER: _ClassVar[int]
    QUEUE_SPEC_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SOURCE_LAG_NANOS_FIELD_NUMBER: _ClassVar[int]
    next_seq: int
    frontier_unix_nano: int
    advance_unix_nano: int
    channel_spec: _channel_pb2.ChannelSpec
    queue_spec: _queue_pb2.QueueSpec
    spec_version: int
    host_time_unix_nano: int
    source_lag_nanos: int
    def __init__(self, next_seq: _Optional[int] = ..., frontier_unix_nano: _Optional[int] = ..., advance_unix_nano: _Optional[int] = ..., channel_spec: _Optional[_Union[_channel_pb2.ChannelSpec, _Mapping]] = ..., queue_spec: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ..., spec_version: _Optional[int] = ..., host_time_unix_nano: _Optional[int] = ..., source_lag_nanos: _Optional[int] = ...) -> None: ...

class GetReplicaStatusRequest(_message.Message):
    __slots__ = ("subject",)
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ...) -> None: ...

class GetReplicaStatusResponse(_message.Message):
    __slots__ = ("status",)
    STATUS_FIELD_NUMBER: _ClassVar[int]
    status: _replica_pb2.ReplicaStatus
    def __init__(self, status: _Optional[_Union[_replica_pb2.ReplicaStatus, _Mapping]] = ...) -> None: ...
