from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class QueueOnFull(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    QUEUE_ON_FULL_UNSPECIFIED: _ClassVar[QueueOnFull]
    QUEUE_ON_FULL_BLOCK: _ClassVar[QueueOnFull]
    QUEUE_ON_FULL_REJECT: _ClassVar[QueueOnFull]
    QUEUE_ON_FULL_DROP_OLDEST: _ClassVar[QueueOnFull]
QUEUE_ON_FULL_UNSPECIFIED: QueueOnFull
QUEUE_ON_FULL_BLOCK: QueueOnFull
QUEUE_ON_FULL_REJECT: QueueOnFull
QUEUE_ON_FULL_DROP_OLDEST: QueueOnFull

class QueueSpec(_message.Message):
    __slots__ = ("max_items", "max_bytes", "on_full", "copies", "lease_nanos", "max_deliveries", "dead_letter_queue_id", "content_type", "max_item_bytes", "replicas", "ack", "min_replicas")
    MAX_ITEMS_FIELD_NUMBER: _ClassVar[int]
    MAX_BYTES_FIELD_NUMBER: _ClassVar[int]
    ON_FULL_FIELD_NUMBER: _ClassVar[int]
    COPIES_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    MAX_DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    DEAD_LETTER_QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    CONTENT_TYPE_FIELD_NUMBER: _ClassVar[int]
    MAX_ITEM_BYTES_FIELD_NUMBER: _ClassVar[int]
    REPLICAS_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    MIN_REPLICAS_FIELD_NUMBER: _ClassVar[int]
    max_items: int
    max_bytes: int
    on_full: QueueOnFull
    copies: int
    lease_nanos: int
    max_deliveries: int
    dead_letter_queue_id: bytes
    content_type: str
    max_item_bytes: int
    replicas: int
    ack: _channel_pb2.Ack
    min_replicas: int
    def __init__(self, max_items: _Optional[int] = ..., max_bytes: _Optional[int] = ..., on_full: _Optional[_Union[QueueOnFull, str]] = ..., copies: _Optional[int] = ..., lease_nanos: _Optional[int] = ..., max_deliveries: _Optional[int] = ..., dead_letter_queue_id: _Optional[bytes] = ..., content_type: _Optional[str] = ..., max_item_bytes: _Optional[int] = ..., replicas: _Optional[int] = ..., ack: _Optional[_Union[_channel_pb2.Ack, str]] = ..., min_replicas: _Optional[int] = ...) -> None: ...

class QueueRecord(_message.Message):
    __slots__ = ("queue_id", "name", "host_id", "epoch", "incarnation", "spec", "spec_version", "mailbox_peer_id", "mailbox_peer_name", "mailbox_owner", "created_by")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_PEER_ID_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_PEER_NAME_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_OWNER_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    spec: QueueSpec
    spec_version: int
    mailbox_peer_id: bytes
    mailbox_peer_name: str
    mailbox_owner: str
    created_by: str
    def __init__(self, queue_id: _Optional[bytes] = ..., name: _Optional[str] = ..., host_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., incarnation: _Optional[int] = ..., spec: _Optional[_Union[QueueSpec, _Mapping]] = ..., spec_version: _Optional[int] = ..., mailbox_peer_id: _Optional[bytes] = ..., mailbox_peer_name: _Optional[str] = ..., mailbox_owner: _Optional[str] = ..., created_by: _Optional[str] = ...) -> None: ...

class QueueCounters(_message.Message):
    __slots__ = ("accepted", "held", "leased", "consumed", "dropped", "dead_lettered", "expelled", "delivered", "given_back", "leases_expired", "rejected_full", "rejected_too_large", "rejected_malformed", "accepted_bytes", "held_bytes", "rejected_overloaded", "terminated", "duplicates")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    LEASED_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    DEAD_LETTERED_FIELD_NUMBER: _ClassVar[int]
    EXPELLED_FIELD_NUMBER: _ClassVar[int]
    DELIVERED_FIELD_NUMBER: _ClassVar[int]
    GIVEN_BACK_FIELD_NUMBER: _ClassVar[int]
    LEASES_EXPIRED_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FULL_FIELD_NUMBER: _ClassVar[int]
    REJECTED_TOO_LARGE_FIELD_NUMBER: _ClassVar[int]
    REJECTED_MALFORMED_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_BYTES_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    REJECTED_OVERLOADED_FIELD_NUMBER: _ClassVar[int]
    TERMINATED_FIELD_NUMBER: _ClassVar[int]
    DUPLICATES_FIELD_NUMBER: _ClassVar[int]
    accepted: int
    held: int
    leased: int
    consumed: int
    dropped: int
    dead_lettered: int
    expelled: int
    delivered: int
    given_back: int
    leases_expired: int
    rejected_full: int
    rejected_too_large: int
    rejected_malformed: int
    accepted_bytes: int
    held_bytes: int
    rejected_overloaded: int
    terminated: int
    duplicates: int
    def __init__(self, accepted: _Optional[int] = ..., held: _Optional[int] = ..., leased: _Optional[int] = ..., consumed: _Optional[int] = ..., dropped: _Optional[int] = ..., dead_lettered: _Optional[int] = ..., expelled: _Optional[int] = ..., delivered: _Optional[int] = ..., given_back: _Optional[int] = ..., leases_expired: _Optional[int] = ..., rejected_full: _Optional[int] = ..., rejected_too_large: _Optional[int] = ..., rejected_malformed: _Optional[int] = ..., accepted_bytes: _Optional[int] = ..., held_bytes: _Optional[int] = ..., rejected_overloaded: _Optional[int] = ..., terminated: _Optional[int] = ..., duplicates: _Optional[int] = ...) -> None: ...

class QueueStatus(_message.Message):
    __slots__ = ("record", "counters", "waiting_takers", "waiting_enqueues", "oldest_accepted_unix_nano", "host_time_unix_nano", "fed_copies")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    WAITING_TAKERS_FIELD_NUMBER: _ClassVar[int]
    WAITING_ENQUEUES_FIELD_NUMBER: _ClassVar[int]
    OLDEST_ACCEPTED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FED_COPIES_FIELD_NUMBER: _ClassVar[int]
    record: QueueRecord
    counters: QueueCounters
    waiting_takers: int
    waiting_enqueues: int
    oldest_accepted_unix_nano: int
    host_time_unix_nano: int
    fed_copies: _containers.RepeatedCompositeFieldContainer[_channel_pb2.FedCopyStatus]
    def __init__(self, record: _Optional[_Union[QueueRecord, _Mapping]] = ..., counters: _Optional[_Union[QueueCounters, _Mapping]] = ..., waiting_takers: _Optional[int] = ..., waiting_enqueues: _Optional[int] = ..., oldest_accepted_unix_nano: _Optional[int] = ..., host_time_unix_nano: _Optional[int] = ..., fed_copies: _Optional[_Iterable[_Union[_channel_pb2.FedCopyStatus, _Mapping]]] = ...) -> None: ...

class LeasedRun(_message.Message):
    __slots__ = ("run", "delivery_ids", "deliveries", "lease_nanos")
    RUN_FIELD_NUMBER: _ClassVar[int]
    DELIVERY_IDS_FIELD_NUMBER: _ClassVar[int]
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    run: _item_pb2.ItemRun
    delivery_ids: _containers.RepeatedScalarFieldContainer[int]
    deliveries: _containers.RepeatedScalarFieldContainer[int]
    lease_nanos: int
    def __init__(self, run: _Optional[_Union[_item_pb2.ItemRun, _Mapping]] = ..., delivery_ids: _Optional[_Iterable[int]] = ..., deliveries: _Optional[_Iterable[int]] = ..., lease_nanos: _Optional[int] = ...) -> None: ...

class Settlement(_message.Message):
    __slots__ = ("delivery_id", "acknowledge", "give_back", "extend_lease", "terminate")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGE_FIELD_NUMBER: _ClassVar[int]
    GIVE_BACK_FIELD_NUMBER: _ClassVar[int]
    EXTEND_LEASE_FIELD_NUMBER: _ClassVar[int]
    TERMINATE_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    acknowledge: Acknowledge
    give_back: GiveBack
    extend_lease: ExtendLease
    terminate: Terminate
    def __init__(self, delivery_id: _Optional[int] = ..., acknowledge: _Optional[_Union[Acknowledge, _Mapping]] = ..., give_back: _Optional[_Union[GiveBack, _Mapping]] = ..., extend_lease: _Optional[_Union[ExtendLease, _Mapping]] = ..., terminate: _Optional[_Union[Terminate, _Mapping]] = ...) -> None: ...

class Acknowledge(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GiveBack(_message.Message):
    __slots__ = ("delay_nanos", "uncounted")
    DELAY_NANOS_FIELD_NUMBER: _ClassVar[int]
    UNCOUNTED_FIELD_NUMBER: _ClassVar[int]
    delay_nanos: int
    uncounted: bool
    def __init__(self, delay_nanos: _Optional[int] = ..., uncounted: bool = ...) -> None: ...

class Terminate(_message.Message):
    __slots__ = ("reason",)
    REASON_FIELD_NUMBER: _ClassVar[int]
    reason: str
    def __init__(self, reason: _Optional[str] = ...) -> None: ...

class ExtendLease(_message.Message):
    __slots__ = ("lease_nanos",)
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    lease_nanos: int
    def __init__(self, lease_nanos: _Optional[int] = ...) -> None: ...

class PendingDelivery(_message.Message):
    __slots__ = ("delivery_id", "seq", "taker_id", "taker_name", "deliveries", "leased_unix_nano", "expires_unix_nano")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    LEASED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    EXPIRES_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    seq: int
    taker_id: int
    taker_name: str
    deliveries: int
    leased_unix_nano: int
    expires_unix_nano: int
    def __init__(self, delivery_id: _Optional[int] = ..., seq: _Optional[int] = ..., taker_id: _Optional[int] = ..., taker_name: _Optional[str] = ..., deliveries: _Optional[int] = ..., leased_unix_nano: _Optional[int] = ..., expires_unix_nano: _Optional[int] = ...) -> None: ...

class SettlementResult(_message.Message):
    __slots__ = ("delivery_id", "error", "lease_nanos")
    DELIVERY_ID_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    delivery_id: int
    error: _error_pb2.Error
    lease_nanos: int
    def __init__(self, delivery_id: _Optional[int] = ..., error: _Optional[_Union[_error_pb2.Error, _Mapping]] = ..., lease_nanos: _Optional[int] = ...) -> None: ...
