from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from stampede_rt.v1 import replica_service_pb2 as _replica_service_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DrainHostRequest(_message.Message):
    __slots__ = ("timeout_nanos",)
    TIMEOUT_NANOS_FIELD_NUMBER: _ClassVar[int]
    timeout_nanos: int
    def __init__(self, timeout_nanos: _Optional[int] = ...) -> None: ...

class DrainHostResponse(_message.Message):
    __slots__ = ("moved", "left", "left_count")
    MOVED_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    LEFT_COUNT_FIELD_NUMBER: _ClassVar[int]
    moved: int
    left: _containers.RepeatedCompositeFieldContainer[ChannelNotMoved]
    left_count: int
    def __init__(self, moved: _Optional[int] = ..., left: _Optional[_Iterable[_Union[ChannelNotMoved, _Mapping]]] = ..., left_count: _Optional[int] = ...) -> None: ...

class ChannelNotMoved(_message.Message):
    __slots__ = ("name", "reason")
    NAME_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    name: str
    reason: str
    def __init__(self, name: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class AllowMoveRequest(_message.Message):
    __slots__ = ("channel_id", "queue_id", "to_host_id")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    queue_id: bytes
    to_host_id: bytes
    def __init__(self, channel_id: _Optional[bytes] = ..., queue_id: _Optional[bytes] = ..., to_host_id: _Optional[bytes] = ...) -> None: ...

class AllowMoveResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class MoveHereRequest(_message.Message):
    __slots__ = ("channel_id", "queue_id")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    queue_id: bytes
    def __init__(self, channel_id: _Optional[bytes] = ..., queue_id: _Optional[bytes] = ...) -> None: ...

class MoveHereResponse(_message.Message):
    __slots__ = ("channel", "queue", "held", "held_bytes", "blackout_nanos")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    BLACKOUT_NANOS_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    queue: _queue_pb2.QueueRecord
    held: int
    held_bytes: int
    blackout_nanos: int
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., held: _Optional[int] = ..., held_bytes: _Optional[int] = ..., blackout_nanos: _Optional[int] = ...) -> None: ...

class MoveEachHereRequest(_message.Message):
    __slots__ = ("channel_ids",)
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class MoveEachHereResponse(_message.Message):
    __slots__ = ("outcomes",)
    OUTCOMES_FIELD_NUMBER: _ClassVar[int]
    outcomes: _containers.RepeatedCompositeFieldContainer[MoveOutcome]
    def __init__(self, outcomes: _Optional[_Iterable[_Union[MoveOutcome, _Mapping]]] = ...) -> None: ...

class MoveOutcome(_message.Message):
    __slots__ = ("channel_id", "error")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    error: _error_pb2.Error
    def __init__(self, channel_id: _Optional[bytes] = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ...) -> None: ...

class HandOverQueueRequest(_message.Message):
    __slots__ = ("open", "committed_epoch", "has_copy")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_EPOCH_FIELD_NUMBER: _ClassVar[int]
    HAS_COPY_FIELD_NUMBER: _ClassVar[int]
    open: HandOverQueueOpen
    committed_epoch: int
    has_copy: bool
    def __init__(self, open: _Optional[_Union[HandOverQueueOpen, _Mapping]] = ..., committed_epoch: _Optional[int] = ..., has_copy: bool = ...) -> None: ...

class FeedQueueRequest(_message.Message):
    __slots__ = ("owner_host_id", "queue", "begins_anew", "parts", "put")
    OWNER_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    BEGINS_ANEW_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    PUT_FIELD_NUMBER: _ClassVar[int]
    owner_host_id: bytes
    queue: _queue_pb2.QueueRecord
    begins_anew: bool
    parts: _containers.RepeatedCompositeFieldContainer[FedQueuePart]
    put: FedQueuePut
    def __init__(self, owner_host_id: _Optional[bytes] = ..., queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., begins_anew: bool = ..., parts: _Optional[_Iterable[_Union[FedQueuePart, _Mapping]]] = ..., put: _Optional[_Union[FedQueuePut, _Mapping]] = ...) -> None: ...

class FedQueuePut(_message.Message):
    __slots__ = ("step", "seq", "producer_id", "first_number", "stamped_unix_nano", "payload_length_bytes", "is_stamped", "owner", "run")
    STEP_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    STAMPED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_LENGTH_BYTES_FIELD_NUMBER: _ClassVar[int]
    IS_STAMPED_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    step: int
    seq: int
    producer_id: int
    first_number: int
    stamped_unix_nano: int
    payload_length_bytes: int
    is_stamped: bool
    owner: str
    run: bytes
    def __init__(self, step: _Optional[int] = ..., seq: _Optional[int] = ..., producer_id: _Optional[int] = ..., first_number: _Optional[int] = ..., stamped_unix_nano: _Optional[int] = ..., payload_length_bytes: _Optional[int] = ..., is_stamped: bool = ..., owner: _Optional[str] = ..., run: _Optional[bytes] = ...) -> None: ...

class FedQueuePart(_message.Message):
    __slots__ = ("content", "next_step", "removed", "ago_nanos")
    CONTENT_FIELD_NUMBER: _ClassVar[int]
    NEXT_STEP_FIELD_NUMBER: _ClassVar[int]
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    content: HandOverQueueResponse
    next_step: int
    removed: _containers.RepeatedCompositeFieldContainer[_subject_pb2.SeqRange]
    ago_nanos: int
    def __init__(self, content: _Optional[_Union[HandOverQueueResponse, _Mapping]] = ..., next_step: _Optional[int] = ..., removed: _Optional[_Iterable[_Union[_subject_pb2.SeqRange, _Mapping]]] = ..., ago_nanos: _Optional[int] = ...) -> None: ...

class FeedQueueResponse(_message.Message):
    __slots__ = ("next_step", "incarnation", "owner_epoch", "takes_changes", "takes_puts", "put_next_step")
    NEXT_STEP_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    OWNER_EPOCH_FIELD_NUMBER: _ClassVar[int]
    TAKES_CHANGES_FIELD_NUMBER: _ClassVar[int]
    TAKES_PUTS_FIELD_NUMBER: _ClassVar[int]
    PUT_NEXT_STEP_FIELD_NUMBER: _ClassVar[int]
    next_step: int
    incarnation: int
    owner_epoch: int
    takes_changes: bool
    takes_puts: bool
    put_next_step: int
    def __init__(self, next_step: _Optional[int] = ..., incarnation: _Optional[int] = ..., owner_epoch: _Optional[int] = ..., takes_changes: bool = ..., takes_puts: bool = ..., put_next_step: _Optional[int] = ...) -> None: ...

class HandOverQueueOpen(_message.Message):
    __slots__ = ("queue_id", "epoch", "host_id", "takes_steps")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TAKES_STEPS_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    host_id: bytes
    takes_steps: bool
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., takes_steps: bool = ...) -> None: ...

class HandOverQueueResponse(_message.Message):
    __slots__ = ("facts", "runs", "more_body", "held", "messages", "acknowledged", "producers", "message_ids", "ends", "permit", "steps_follow", "steps", "is_held", "held_nanos")
    FACTS_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    MORE_BODY_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    PRODUCERS_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_IDS_FIELD_NUMBER: _ClassVar[int]
    ENDS_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    STEPS_FOLLOW_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    IS_HELD_FIELD_NUMBER: _ClassVar[int]
    HELD_NANOS_FIELD_NUMBER: _ClassVar[int]
    facts: HandedQueueFacts
    runs: _containers.RepeatedCompositeFieldContainer[HandedRun]
    more_body: bytes
    held: _containers.RepeatedCompositeFieldContainer[_subject_pb2.SeqRange]
    messages: _containers.RepeatedCompositeFieldContainer[HandedMessage]
    acknowledged: _containers.RepeatedCompositeFieldContainer[HandedAcknowledgement]
    producers: _containers.RepeatedCompositeFieldContainer[_replica_service_pb2.FedProducer]
    message_ids: _containers.RepeatedCompositeFieldContainer[HandedMessageId]
    ends: bool
    permit: bytes
    steps_follow: bool
    steps: _containers.RepeatedCompositeFieldContainer[FedQueuePart]
    is_held: bool
    held_nanos: int
    def __init__(self, facts: _Optional[_Union[HandedQueueFacts, _Mapping]] = ..., runs: _Optional[_Iterable[_Union[HandedRun, _Mapping]]] = ..., more_body: _Optional[bytes] = ..., held: _Optional[_Iterable[_Union[_subject_pb2.SeqRange, _Mapping]]] = ..., messages: _Optional[_Iterable[_Union[HandedMessage, _Mapping]]] = ..., acknowledged: _Optional[_Iterable[_Union[HandedAcknowledgement, _Mapping]]] = ..., producers: _Optional[_Iterable[_Union[_replica_service_pb2.FedProducer, _Mapping]]] = ..., message_ids: _Optional[_Iterable[_Union[HandedMessageId, _Mapping]]] = ..., ends: bool = ..., permit: _Optional[bytes] = ..., steps_follow: bool = ..., steps: _Optional[_Iterable[_Union[FedQueuePart, _Mapping]]] = ..., is_held: bool = ..., held_nanos: _Optional[int] = ...) -> None: ...

class HandedQueueFacts(_message.Message):
    __slots__ = ("next_seq", "next_delivery_id", "counters", "next_step")
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    NEXT_DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    NEXT_STEP_FIELD_NUMBER: _ClassVar[int]
    next_seq: int
    next_delivery_id: int
    counters: _queue_pb2.QueueCounters
    next_step: int
    def __init__(self, next_seq: _Optional[int] = ..., next_delivery_id: _Optional[int] = ..., counters: _Optional[_Union[_queue_pb2.QueueCounters, _Mapping]] = ..., next_step: _Optional[int] = ...) -> None: ...

class HandedRun(_message.Message):
    __slots__ = ("first_seq", "length_bytes", "accepted_ago_nanos", "body")
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    LENGTH_BYTES_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    BODY_FIELD_NUMBER: _ClassVar[int]
    first_seq: int
    length_bytes: _containers.RepeatedScalarFieldContainer[int]
    accepted_ago_nanos: int
    body: bytes
    def __init__(self, first_seq: _Optional[int] = ..., length_bytes: _Optional[_Iterable[int]] = ..., accepted_ago_nanos: _Optional[int] = ..., body: _Optional[bytes] = ...) -> None: ...

class HandedMessage(_message.Message):
    __slots__ = ("seq", "deliveries", "acknowledged", "leases", "delay_nanos", "is_leaving", "last", "is_change", "ended")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    LEASES_FIELD_NUMBER: _ClassVar[int]
    DELAY_NANOS_FIELD_NUMBER: _ClassVar[int]
    IS_LEAVING_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    IS_CHANGE_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    seq: int
    deliveries: _containers.RepeatedScalarFieldContainer[int]
    acknowledged: _containers.RepeatedScalarFieldContainer[int]
    leases: _containers.RepeatedCompositeFieldContainer[HandedLease]
    delay_nanos: int
    is_leaving: bool
    last: HandedFailure
    is_change: bool
    ended: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, seq: _Optional[int] = ..., deliveries: _Optional[_Iterable[int]] = ..., acknowledged: _Optional[_Iterable[int]] = ..., leases: _Optional[_Iterable[_Union[HandedLease, _Mapping]]] = ..., delay_nanos: _Optional[int] = ..., is_leaving: bool = ..., last: _Optional[_Union[HandedFailure, _Mapping]] = ..., is_change: bool = ..., ended: _Optional[_Iterable[int]] = ...) -> None: ...

class HandedLease(_message.Message):
    __slots__ = ("delivery_id", "taker_id", "taker_name", "lease_nanos", "leased_ago_nanos")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    LEASED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    taker_id: int
    taker_name: str
    lease_nanos: int
    leased_ago_nanos: int
    def __init__(self, delivery_id: _Optional[int] = ..., taker_id: _Optional[int] = ..., taker_name: _Optional[str] = ..., lease_nanos: _Optional[int] = ..., leased_ago_nanos: _Optional[int] = ...) -> None: ...

class HandedFailure(_message.Message):
    __slots__ = ("number", "taker_id", "taker_name", "ended", "reason")
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    number: int
    taker_id: int
    taker_name: str
    ended: str
    reason: str
    def __init__(self, number: _Optional[int] = ..., taker_id: _Optional[int] = ..., taker_name: _Optional[str] = ..., ended: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class HandedAcknowledgement(_message.Message):
    __slots__ = ("delivery_id", "taker_id", "ago_nanos")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    taker_id: int
    ago_nanos: int
    def __init__(self, delivery_id: _Optional[int] = ..., taker_id: _Optional[int] = ..., ago_nanos: _Optional[int] = ...) -> None: ...

class HandedMessageId(_message.Message):
    __slots__ = ("message_id", "seq", "ago_nanos", "owner")
    MESSAGE_ID_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    message_id: str
    seq: int
    ago_nanos: int
    owner: str
    def __init__(self, message_id: _Optional[str] = ..., seq: _Optional[int] = ..., ago_nanos: _Optional[int] = ..., owner: _Optional[str] = ...) -> None: ...
