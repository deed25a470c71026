from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from stampede_rt.v1 import time_pb2 as _time_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class SubscribeMode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    SUBSCRIBE_MODE_UNSPECIFIED: _ClassVar[SubscribeMode]
    SUBSCRIBE_MODE_ALL: _ClassVar[SubscribeMode]
    SUBSCRIBE_MODE_NEWEST: _ClassVar[SubscribeMode]
SUBSCRIBE_MODE_UNSPECIFIED: SubscribeMode
SUBSCRIBE_MODE_ALL: SubscribeMode
SUBSCRIBE_MODE_NEWEST: SubscribeMode

class PutRequest(_message.Message):
    __slots__ = ("channel_id", "epoch", "producer_id", "puts", "piece")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    PUTS_FIELD_NUMBER: _ClassVar[int]
    PIECE_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    producer_id: int
    puts: _containers.RepeatedCompositeFieldContainer[PutRun]
    piece: RequestPiece
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., producer_id: _Optional[int] = ..., puts: _Optional[_Iterable[_Union[PutRun, _Mapping]]] = ..., piece: _Optional[_Union[RequestPiece, _Mapping]] = ...) -> None: ...

class RequestPiece(_message.Message):
    __slots__ = ("request_bytes", "content")
    REQUEST_BYTES_FIELD_NUMBER: _ClassVar[int]
    CONTENT_FIELD_NUMBER: _ClassVar[int]
    request_bytes: int
    content: bytes
    def __init__(self, request_bytes: _Optional[int] = ..., content: _Optional[bytes] = ...) -> None: ...

class PutRun(_message.Message):
    __slots__ = ("first_number", "wait_nanos", "run", "ack")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    wait_nanos: int
    run: _item_pb2.ItemRun
    ack: _channel_pb2.Ack
    def __init__(self, first_number: _Optional[int] = ..., wait_nanos: _Optional[int] = ..., run: _Optional[_Union[_item_pb2.ItemRun, _Mapping]] = ..., ack: _Optional[_Union[_channel_pb2.Ack, str]] = ...) -> None: ...

class PutResponse(_message.Message):
    __slots__ = ("acks",)
    ACKS_FIELD_NUMBER: _ClassVar[int]
    acks: _containers.RepeatedCompositeFieldContainer[PutAck]
    def __init__(self, acks: _Optional[_Iterable[_Union[PutAck, _Mapping]]] = ...) -> None: ...

class PutAck(_message.Message):
    __slots__ = ("first_number", "items", "first_seq", "stamped_unix_nano", "rejections", "error", "host_time_unix_nano", "incarnation", "later_parts", "duplicate", "copies")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMPED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    REJECTIONS_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    LATER_PARTS_FIELD_NUMBER: _ClassVar[int]
    DUPLICATE_FIELD_NUMBER: _ClassVar[int]
    COPIES_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    items: int
    first_seq: int
    stamped_unix_nano: int
    rejections: _containers.RepeatedCompositeFieldContainer[PutRejection]
    error: _error_pb2.Error
    host_time_unix_nano: int
    incarnation: int
    later_parts: _containers.RepeatedCompositeFieldContainer[PutPart]
    duplicate: bool
    copies: int
    def __init__(self, first_number: _Optional[int] = ..., items: _Optional[int] = ..., first_seq: _Optional[int] = ..., stamped_unix_nano: _Optional[int] = ..., rejections: _Optional[_Iterable[_Union[PutRejection, _Mapping]]] = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ..., host_time_unix_nano: _Optional[int] = ..., incarnation: _Optional[int] = ..., later_parts: _Optional[_Iterable[_Union[PutPart, _Mapping]]] = ..., duplicate: bool = ..., copies: _Optional[int] = ...) -> None: ...

class PutPart(_message.Message):
    __slots__ = ("index", "first_seq", "stamped_unix_nano")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMPED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    index: int
    first_seq: int
    stamped_unix_nano: int
    def __init__(self, index: _Optional[int] = ..., first_seq: _Optional[int] = ..., stamped_unix_nano: _Optional[int] = ...) -> None: ...

class PutRejection(_message.Message):
    __slots__ = ("index", "error")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    index: int
    error: _error_pb2.Error
    def __init__(self, index: _Optional[int] = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ...) -> None: ...

class GetRequest(_message.Message):
    __slots__ = ("call_id", "cancel", "channel_id", "epoch", "interval", "match", "limit", "newest_first", "after", "newer_than", "without_payloads", "wait_nanos", "complete", "group_id", "cut_floor_unix_nano", "max_staleness_nanos", "least_seq", "cut_unix_nano", "within_memory", "as_of_unix_nano", "now_unix_nano")
    CALL_ID_FIELD_NUMBER: _ClassVar[int]
    CANCEL_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    INTERVAL_FIELD_NUMBER: _ClassVar[int]
    MATCH_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    NEWEST_FIRST_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    NEWER_THAN_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_PAYLOADS_FIELD_NUMBER: _ClassVar[int]
    WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    COMPLETE_FIELD_NUMBER: _ClassVar[int]
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    CUT_FLOOR_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    MAX_STALENESS_NANOS_FIELD_NUMBER: _ClassVar[int]
    LEAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    WITHIN_MEMORY_FIELD_NUMBER: _ClassVar[int]
    AS_OF_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NOW_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    call_id: int
    cancel: bool
    channel_id: bytes
    epoch: int
    interval: _time_pb2.Interval
    match: _time_pb2.Match
    limit: int
    newest_first: bool
    after: _item_pb2.ItemPosition
    newer_than: _item_pb2.ItemPosition
    without_payloads: bool
    wait_nanos: int
    complete: bool
    group_id: bytes
    cut_floor_unix_nano: int
    max_staleness_nanos: int
    least_seq: int
    cut_unix_nano: int
    within_memory: bool
    as_of_unix_nano: int
    now_unix_nano: int
    def __init__(self, call_id: _Optional[int] = ..., cancel: bool = ..., channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., interval: _Optional[_Union[_time_pb2.Interval, _Mapping]] = ..., match: _Optional[_Union[_time_pb2.Match, str]] = ..., limit: _Optional[int] = ..., newest_first: bool = ..., after: _Optional[_Union[_item_pb2.ItemPosition, _Mapping]] = ..., newer_than: _Optional[_Union[_item_pb2.ItemPosition, _Mapping]] = ..., without_payloads: bool = ..., wait_nanos: _Optional[int] = ..., complete: bool = ..., group_id: _Optional[bytes] = ..., cut_floor_unix_nano: _Optional[int] = ..., max_staleness_nanos: _Optional[int] = ..., least_seq: _Optional[int] = ..., cut_unix_nano: _Optional[int] = ..., within_memory: bool = ..., as_of_unix_nano: _Optional[int] = ..., now_unix_nano: _Optional[int] = ...) -> None: ...

class GetResponse(_message.Message):
    __slots__ = ("call_id", "runs", "summary", "error")
    CALL_ID_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    SUMMARY_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    call_id: int
    runs: _containers.RepeatedCompositeFieldContainer[_item_pb2.DeliveredRun]
    summary: GetSummary
    error: _error_pb2.Error
    def __init__(self, call_id: _Optional[int] = ..., runs: _Optional[_Iterable[_Union[_item_pb2.DeliveredRun, _Mapping]]] = ..., summary: _Optional[_Union[GetSummary, _Mapping]] = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ...) -> None: ...

class GetSummary(_message.Message):
    __slots__ = ("interval", "complete", "truncated", "more", "reason", "detail", "incarnation", "cut_unix_nano", "host_time_unix_nano", "staleness_nanos", "continues", "past", "lost_before_unix_nano")
    INTERVAL_FIELD_NUMBER: _ClassVar[int]
    COMPLETE_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    STALENESS_NANOS_FIELD_NUMBER: _ClassVar[int]
    CONTINUES_FIELD_NUMBER: _ClassVar[int]
    PAST_FIELD_NUMBER: _ClassVar[int]
    LOST_BEFORE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    interval: _time_pb2.ResolvedInterval
    complete: bool
    truncated: bool
    more: bool
    reason: _error_pb2.AbsenceReason
    detail: str
    incarnation: int
    cut_unix_nano: int
    host_time_unix_nano: int
    staleness_nanos: int
    continues: bool
    past: PastSummary
    lost_before_unix_nano: int
    def __init__(self, interval: _Optional[_Union[_time_pb2.ResolvedInterval, _Mapping]] = ..., complete: bool = ..., truncated: bool = ..., more: bool = ..., reason: _Optional[_Union[_error_pb2.AbsenceReason, str]] = ..., detail: _Optional[str] = ..., incarnation: _Optional[int] = ..., cut_unix_nano: _Optional[int] = ..., host_time_unix_nano: _Optional[int] = ..., staleness_nanos: _Optional[int] = ..., continues: bool = ..., past: _Optional[_Union[PastSummary, _Mapping]] = ..., lost_before_unix_nano: _Optional[int] = ...) -> None: ...

class PastSummary(_message.Message):
    __slots__ = ("advance_unix_nano", "next_change_unix_nano", "next_seq", "next_start_unix_nano", "next_end_unix_nano")
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NEXT_CHANGE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    NEXT_START_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NEXT_END_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    advance_unix_nano: int
    next_change_unix_nano: int
    next_seq: int
    next_start_unix_nano: int
    next_end_unix_nano: int
    def __init__(self, advance_unix_nano: _Optional[int] = ..., next_change_unix_nano: _Optional[int] = ..., next_seq: _Optional[int] = ..., next_start_unix_nano: _Optional[int] = ..., next_end_unix_nano: _Optional[int] = ...) -> None: ...

class SubscribeRequest(_message.Message):
    __slots__ = ("open", "credit_bytes", "repair_next_seq", "one_response")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    CREDIT_BYTES_FIELD_NUMBER: _ClassVar[int]
    REPAIR_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    ONE_RESPONSE_FIELD_NUMBER: _ClassVar[int]
    open: SubscribeOpen
    credit_bytes: int
    repair_next_seq: int
    one_response: bool
    def __init__(self, open: _Optional[_Union[SubscribeOpen, _Mapping]] = ..., credit_bytes: _Optional[int] = ..., repair_next_seq: _Optional[int] = ..., one_response: bool = ...) -> None: ...

class SubscribeOpen(_message.Message):
    __slots__ = ("channel_id", "epoch", "mode", "start", "after", "cursor", "without_payloads", "group_id", "stale_ok", "stay", "multicast")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    MODE_FIELD_NUMBER: _ClassVar[int]
    START_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_PAYLOADS_FIELD_NUMBER: _ClassVar[int]
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    STAY_FIELD_NUMBER: _ClassVar[int]
    MULTICAST_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    mode: SubscribeMode
    start: _time_pb2.Bound
    after: _item_pb2.ItemPosition
    cursor: SubscriptionCursor
    without_payloads: bool
    group_id: bytes
    stale_ok: bool
    stay: bool
    multicast: bool
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., mode: _Optional[_Union[SubscribeMode, str]] = ..., start: _Optional[_Union[_time_pb2.Bound, _Mapping]] = ..., after: _Optional[_Union[_item_pb2.ItemPosition, _Mapping]] = ..., cursor: _Optional[_Union[SubscriptionCursor, _Mapping]] = ..., without_payloads: bool = ..., group_id: _Optional[bytes] = ..., stale_ok: bool = ..., stay: bool = ..., multicast: bool = ...) -> None: ...

class SubscriptionCursor(_message.Message):
    __slots__ = ("incarnation", "next_seq", "from_unix_nano", "from_seq", "live_seq", "cut_unix_nano")
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    FROM_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FROM_SEQ_FIELD_NUMBER: _ClassVar[int]
    LIVE_SEQ_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    incarnation: int
    next_seq: int
    from_unix_nano: int
    from_seq: int
    live_seq: int
    cut_unix_nano: int
    def __init__(self, incarnation: _Optional[int] = ..., next_seq: _Optional[int] = ..., from_unix_nano: _Optional[int] = ..., from_seq: _Optional[int] = ..., live_seq: _Optional[int] = ..., cut_unix_nano: _Optional[int] = ...) -> None: ...

class SubscribeResponse(_message.Message):
    __slots__ = ("opened", "gap", "runs", "progress", "cursor", "multicast", "repair_next_seq")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    GAP_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    PROGRESS_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    MULTICAST_FIELD_NUMBER: _ClassVar[int]
    REPAIR_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    opened: SubscriptionOpened
    gap: SubscriptionGap
    runs: _containers.RepeatedCompositeFieldContainer[_item_pb2.DeliveredRun]
    progress: SubscriptionProgress
    cursor: SubscriptionCursor
    multicast: MulticastOffer
    repair_next_seq: int
    def __init__(self, opened: _Optional[_Union[SubscriptionOpened, _Mapping]] = ..., gap: _Optional[_Union[SubscriptionGap, _Mapping]] = ..., runs: _Optional[_Iterable[_Union[_item_pb2.DeliveredRun, _Mapping]]] = ..., progress: _Optional[_Union[SubscriptionProgress, _Mapping]] = ..., cursor: _Optional[_Union[SubscriptionCursor, _Mapping]] = ..., multicast: _Optional[_Union[MulticastOffer, _Mapping]] = ..., repair_next_seq: _Optional[int] = ...) -> None: ...

class MulticastOffer(_message.Message):
    __slots__ = ("group", "stream_id", "key_number", "key", "public_key")
    GROUP_FIELD_NUMBER: _ClassVar[int]
    STREAM_ID_FIELD_NUMBER: _ClassVar[int]
    KEY_NUMBER_FIELD_NUMBER: _ClassVar[int]
    KEY_FIELD_NUMBER: _ClassVar[int]
    PUBLIC_KEY_FIELD_NUMBER: _ClassVar[int]
    group: str
    stream_id: bytes
    key_number: int
    key: bytes
    public_key: bytes
    def __init__(self, group: _Optional[str] = ..., stream_id: _Optional[bytes] = ..., key_number: _Optional[int] = ..., key: _Optional[bytes] = ..., public_key: _Optional[bytes] = ...) -> None: ...

class SubscriptionOpened(_message.Message):
    __slots__ = ("incarnation", "next_seq")
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    incarnation: int
    next_seq: int
    def __init__(self, incarnation: _Optional[int] = ..., next_seq: _Optional[int] = ...) -> None: ...

class SubscriptionGap(_message.Message):
    __slots__ = ("first_seq", "last_seq", "items", "reason", "detail")
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    LAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    first_seq: int
    last_seq: int
    items: int
    reason: _error_pb2.AbsenceReason
    detail: str
    def __init__(self, first_seq: _Optional[int] = ..., last_seq: _Optional[int] = ..., items: _Optional[int] = ..., reason: _Optional[_Union[_error_pb2.AbsenceReason, str]] = ..., detail: _Optional[str] = ...) -> None: ...

class SubscriptionProgress(_message.Message):
    __slots__ = ("next_seq", "skipped", "dropped", "advance_unix_nano", "host_time_unix_nano")
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    next_seq: int
    skipped: int
    dropped: int
    advance_unix_nano: int
    host_time_unix_nano: int
    def __init__(self, next_seq: _Optional[int] = ..., skipped: _Optional[int] = ..., dropped: _Optional[int] = ..., advance_unix_nano: _Optional[int] = ..., host_time_unix_nano: _Optional[int] = ...) -> None: ...

class ShareMemoryRequest(_message.Message):
    __slots__ = ("channel_id", "epoch")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class ShareMemoryResponse(_message.Message):
    __slots__ = ("memory_bytes", "detail")
    MEMORY_BYTES_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    memory_bytes: int
    detail: str
    def __init__(self, memory_bytes: _Optional[int] = ..., detail: _Optional[str] = ...) -> None: ...

class AdvanceRequest(_message.Message):
    __slots__ = ("channel_id", "epoch", "time_unix_nano")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    time_unix_nano: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., time_unix_nano: _Optional[int] = ...) -> None: ...

class AdvanceResponse(_message.Message):
    __slots__ = ("advance_unix_nano",)
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    advance_unix_nano: int
    def __init__(self, advance_unix_nano: _Optional[int] = ...) -> None: ...

class ConsumeRequest(_message.Message):
    __slots__ = ("channel_id", "epoch", "consumer_id", "seqs", "incarnation", "lease_nanos")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    CONSUMER_ID_FIELD_NUMBER: _ClassVar[int]
    SEQS_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    consumer_id: int
    seqs: _containers.RepeatedScalarFieldContainer[int]
    incarnation: int
    lease_nanos: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., consumer_id: _Optional[int] = ..., seqs: _Optional[_Iterable[int]] = ..., incarnation: _Optional[int] = ..., lease_nanos: _Optional[int] = ...) -> None: ...

class ConsumeResponse(_message.Message):
    __slots__ = ("consumed", "lease_nanos")
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    consumed: int
    lease_nanos: int
    def __init__(self, consumed: _Optional[int] = ..., lease_nanos: _Optional[int] = ...) -> None: ...

class GetChannelStatusRequest(_message.Message):
    __slots__ = ("channel_id", "epoch")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class GetChannelStatusResponse(_message.Message):
    __slots__ = ("status", "users")
    STATUS_FIELD_NUMBER: _ClassVar[int]
    USERS_FIELD_NUMBER: _ClassVar[int]
    status: _channel_pb2.ChannelStatus
    users: ChannelUsers
    def __init__(self, status: _Optional[_Union[_channel_pb2.ChannelStatus, _Mapping]] = ..., users: _Optional[_Union[ChannelUsers, _Mapping]] = ...) -> None: ...

class ChannelUsers(_message.Message):
    __slots__ = ("readers", "writers")
    READERS_FIELD_NUMBER: _ClassVar[int]
    WRITERS_FIELD_NUMBER: _ClassVar[int]
    readers: _containers.RepeatedCompositeFieldContainer[ChannelReader]
    writers: _containers.RepeatedCompositeFieldContainer[ChannelWriter]
    def __init__(self, readers: _Optional[_Iterable[_Union[ChannelReader, _Mapping]]] = ..., writers: _Optional[_Iterable[_Union[ChannelWriter, _Mapping]]] = ...) -> None: ...

class ChannelReader(_message.Message):
    __slots__ = ("subscriber", "collected", "skipped")
    SUBSCRIBER_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_FIELD_NUMBER: _ClassVar[int]
    SKIPPED_FIELD_NUMBER: _ClassVar[int]
    subscriber: str
    collected: int
    skipped: int
    def __init__(self, subscriber: _Optional[str] = ..., collected: _Optional[int] = ..., skipped: _Optional[int] = ...) -> None: ...

class ChannelWriter(_message.Message):
    __slots__ = ("name", "last_put_unix_nano")
    NAME_FIELD_NUMBER: _ClassVar[int]
    LAST_PUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    name: str
    last_put_unix_nano: int
    def __init__(self, name: _Optional[str] = ..., last_put_unix_nano: _Optional[int] = ...) -> None: ...
