from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class OnFull(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ON_FULL_UNSPECIFIED: _ClassVar[OnFull]
    ON_FULL_DROP_OLDEST: _ClassVar[OnFull]
    ON_FULL_BLOCK: _ClassVar[OnFull]
    ON_FULL_REJECT: _ClassVar[OnFull]

class Ack(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ACK_UNSPECIFIED: _ClassVar[Ack]
    ACK_HOST: _ClassVar[Ack]
    ACK_REPLICA: _ClassVar[Ack]
    ACK_DISK: _ClassVar[Ack]
ON_FULL_UNSPECIFIED: OnFull
ON_FULL_DROP_OLDEST: OnFull
ON_FULL_BLOCK: OnFull
ON_FULL_REJECT: OnFull
ACK_UNSPECIFIED: Ack
ACK_HOST: Ack
ACK_REPLICA: Ack
ACK_DISK: Ack

class RetentionPolicy(_message.Message):
    __slots__ = ("max_age_nanos", "max_items", "max_bytes", "consumers", "max_age_unconsumed_nanos")
    MAX_AGE_NANOS_FIELD_NUMBER: _ClassVar[int]
    MAX_ITEMS_FIELD_NUMBER: _ClassVar[int]
    MAX_BYTES_FIELD_NUMBER: _ClassVar[int]
    CONSUMERS_FIELD_NUMBER: _ClassVar[int]
    MAX_AGE_UNCONSUMED_NANOS_FIELD_NUMBER: _ClassVar[int]
    max_age_nanos: int
    max_items: int
    max_bytes: int
    consumers: int
    max_age_unconsumed_nanos: int
    def __init__(self, max_age_nanos: _Optional[int] = ..., max_items: _Optional[int] = ..., max_bytes: _Optional[int] = ..., consumers: _Optional[int] = ..., max_age_unconsumed_nanos: _Optional[int] = ...) -> None: ...

class ChannelSpec(_message.Message):
    __slots__ = ("retention", "on_full", "max_future_nanos", "content_type", "max_item_bytes", "overlap_nanos", "replicas", "ack", "min_replicas", "archive_nanos", "archive_bytes")
    RETENTION_FIELD_NUMBER: _ClassVar[int]
    ON_FULL_FIELD_NUMBER: _ClassVar[int]
    MAX_FUTURE_NANOS_FIELD_NUMBER: _ClassVar[int]
    CONTENT_TYPE_FIELD_NUMBER: _ClassVar[int]
    MAX_ITEM_BYTES_FIELD_NUMBER: _ClassVar[int]
    OVERLAP_NANOS_FIELD_NUMBER: _ClassVar[int]
    REPLICAS_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    MIN_REPLICAS_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_NANOS_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_BYTES_FIELD_NUMBER: _ClassVar[int]
    retention: RetentionPolicy
    on_full: OnFull
    max_future_nanos: int
    content_type: str
    max_item_bytes: int
    overlap_nanos: int
    replicas: int
    ack: Ack
    min_replicas: int
    archive_nanos: int
    archive_bytes: int
    def __init__(self, retention: _Optional[_Union[RetentionPolicy, _Mapping]] = ..., on_full: _Optional[_Union[OnFull, str]] = ..., max_future_nanos: _Optional[int] = ..., content_type: _Optional[str] = ..., max_item_bytes: _Optional[int] = ..., overlap_nanos: _Optional[int] = ..., replicas: _Optional[int] = ..., ack: _Optional[_Union[Ack, str]] = ..., min_replicas: _Optional[int] = ..., archive_nanos: _Optional[int] = ..., archive_bytes: _Optional[int] = ...) -> None: ...

class ChannelRecord(_message.Message):
    __slots__ = ("channel_id", "name", "host_id", "epoch", "incarnation", "spec", "spec_version", "proxy_host_ids", "created_by", "first_incarnation")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    PROXY_HOST_IDS_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    FIRST_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    name: str
    host_id: bytes
    epoch: int
    incarnation: int
    spec: ChannelSpec
    spec_version: int
    proxy_host_ids: _containers.RepeatedScalarFieldContainer[bytes]
    created_by: str
    first_incarnation: int
    def __init__(self, channel_id: _Optional[bytes] = ..., name: _Optional[str] = ..., host_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., incarnation: _Optional[int] = ..., spec: _Optional[_Union[ChannelSpec, _Mapping]] = ..., spec_version: _Optional[int] = ..., proxy_host_ids: _Optional[_Iterable[bytes]] = ..., created_by: _Optional[str] = ..., first_incarnation: _Optional[int] = ...) -> None: ...

class ChannelCounters(_message.Message):
    __slots__ = ("accepted", "held", "collected_by_age", "collected_by_count", "collected_by_bytes", "collected_by_consumption", "rejected_too_old", "rejected_in_future", "rejected_too_large", "rejected_full", "accepted_bytes", "held_bytes", "delivered_bytes", "rejected_malformed", "rejected_overloaded", "not_replicated")
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_BY_AGE_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_BY_COUNT_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_BY_BYTES_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_BY_CONSUMPTION_FIELD_NUMBER: _ClassVar[int]
    REJECTED_TOO_OLD_FIELD_NUMBER: _ClassVar[int]
    REJECTED_IN_FUTURE_FIELD_NUMBER: _ClassVar[int]
    REJECTED_TOO_LARGE_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FULL_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_BYTES_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    DELIVERED_BYTES_FIELD_NUMBER: _ClassVar[int]
    REJECTED_MALFORMED_FIELD_NUMBER: _ClassVar[int]
    REJECTED_OVERLOADED_FIELD_NUMBER: _ClassVar[int]
    NOT_REPLICATED_FIELD_NUMBER: _ClassVar[int]
    accepted: int
    held: int
    collected_by_age: int
    collected_by_count: int
    collected_by_bytes: int
    collected_by_consumption: int
    rejected_too_old: int
    rejected_in_future: int
    rejected_too_large: int
    rejected_full: int
    accepted_bytes: int
    held_bytes: int
    delivered_bytes: int
    rejected_malformed: int
    rejected_overloaded: int
    not_replicated: int
    def __init__(self, accepted: _Optional[int] = ..., held: _Optional[int] = ..., collected_by_age: _Optional[int] = ..., collected_by_count: _Optional[int] = ..., collected_by_bytes: _Optional[int] = ..., collected_by_consumption: _Optional[int] = ..., rejected_too_old: _Optional[int] = ..., rejected_in_future: _Optional[int] = ..., rejected_too_large: _Optional[int] = ..., rejected_full: _Optional[int] = ..., accepted_bytes: _Optional[int] = ..., held_bytes: _Optional[int] = ..., delivered_bytes: _Optional[int] = ..., rejected_malformed: _Optional[int] = ..., rejected_overloaded: _Optional[int] = ..., not_replicated: _Optional[int] = ...) -> None: ...

class ChannelStatus(_message.Message):
    __slots__ = ("record", "counters", "newest_unix_nano", "oldest_unix_nano", "frontier_unix_nano", "advance_unix_nano", "subscriptions", "waiting_gets", "waiting_puts", "host_time_unix_nano", "consumers", "copy", "fed_copies", "replicated_next_seq", "dropped", "inherited_next_seq", "multicast", "archive", "next_seq", "has_lost_items")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    NEWEST_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    OLDEST_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FRONTIER_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIPTIONS_FIELD_NUMBER: _ClassVar[int]
    WAITING_GETS_FIELD_NUMBER: _ClassVar[int]
    WAITING_PUTS_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CONSUMERS_FIELD_NUMBER: _ClassVar[int]
    COPY_FIELD_NUMBER: _ClassVar[int]
    FED_COPIES_FIELD_NUMBER: _ClassVar[int]
    REPLICATED_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    INHERITED_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    MULTICAST_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    HAS_LOST_ITEMS_FIELD_NUMBER: _ClassVar[int]
    record: ChannelRecord
    counters: ChannelCounters
    newest_unix_nano: int
    oldest_unix_nano: int
    frontier_unix_nano: int
    advance_unix_nano: int
    subscriptions: int
    waiting_gets: int
    waiting_puts: int
    host_time_unix_nano: int
    consumers: _containers.RepeatedCompositeFieldContainer[ConsumerStatus]
    copy: CopyStatus
    fed_copies: _containers.RepeatedCompositeFieldContainer[FedCopyStatus]
    replicated_next_seq: int
    dropped: int
    inherited_next_seq: int
    multicast: MulticastStatus
    archive: ArchiveStatus
    next_seq: int
    has_lost_items: bool
    def __init__(self, record: _Optional[_Union[ChannelRecord, _Mapping]] = ..., counters: _Optional[_Union[ChannelCounters, _Mapping]] = ..., newest_unix_nano: _Optional[int] = ..., oldest_unix_nano: _Optional[int] = ..., frontier_unix_nano: _Optional[int] = ..., advance_unix_nano: _Optional[int] = ..., subscriptions: _Optional[int] = ..., waiting_gets: _Optional[int] = ..., waiting_puts: _Optional[int] = ..., host_time_unix_nano: _Optional[int] = ..., consumers: _Optional[_Iterable[_Union[ConsumerStatus, _Mapping]]] = ..., copy: _Optional[_Union[CopyStatus, _Mapping]] = ..., fed_copies: _Optional[_Iterable[_Union[FedCopyStatus, _Mapping]]] = ..., replicated_next_seq: _Optional[int] = ..., dropped: _Optional[int] = ..., inherited_next_seq: _Optional[int] = ..., multicast: _Optional[_Union[MulticastStatus, _Mapping]] = ..., archive: _Optional[_Union[ArchiveStatus, _Mapping]] = ..., next_seq: _Optional[int] = ..., has_lost_items: bool = ...) -> None: ...

class ArchiveStatus(_message.Message):
    __slots__ = ("items", "bytes", "disk_bytes", "oldest_unix_nano", "newest_unix_nano", "waiting", "unarchived", "place", "failure")
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    DISK_BYTES_FIELD_NUMBER: _ClassVar[int]
    OLDEST_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NEWEST_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    WAITING_FIELD_NUMBER: _ClassVar[int]
    UNARCHIVED_FIELD_NUMBER: _ClassVar[int]
    PLACE_FIELD_NUMBER: _ClassVar[int]
    FAILURE_FIELD_NUMBER: _ClassVar[int]
    items: int
    bytes: int
    disk_bytes: int
    oldest_unix_nano: int
    newest_unix_nano: int
    waiting: int
    unarchived: int
    place: str
    failure: str
    def __init__(self, items: _Optional[int] = ..., bytes: _Optional[int] = ..., disk_bytes: _Optional[int] = ..., oldest_unix_nano: _Optional[int] = ..., newest_unix_nano: _Optional[int] = ..., waiting: _Optional[int] = ..., unarchived: _Optional[int] = ..., place: _Optional[str] = ..., failure: _Optional[str] = ...) -> None: ...

class MulticastStatus(_message.Message):
    __slots__ = ("group", "readers", "datagrams", "bytes", "repairs")
    GROUP_FIELD_NUMBER: _ClassVar[int]
    READERS_FIELD_NUMBER: _ClassVar[int]
    DATAGRAMS_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    REPAIRS_FIELD_NUMBER: _ClassVar[int]
    group: str
    readers: int
    datagrams: int
    bytes: int
    repairs: int
    def __init__(self, group: _Optional[str] = ..., readers: _Optional[int] = ..., datagrams: _Optional[int] = ..., bytes: _Optional[int] = ..., repairs: _Optional[int] = ...) -> None: ...

class CopyStatus(_message.Message):
    __slots__ = ("source_host_id", "staleness_nanos", "source_next_seq", "missed", "ready", "reconnects", "waiting")
    SOURCE_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    STALENESS_NANOS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    MISSED_FIELD_NUMBER: _ClassVar[int]
    READY_FIELD_NUMBER: _ClassVar[int]
    RECONNECTS_FIELD_NUMBER: _ClassVar[int]
    WAITING_FIELD_NUMBER: _ClassVar[int]
    source_host_id: bytes
    staleness_nanos: int
    source_next_seq: int
    missed: int
    ready: bool
    reconnects: int
    waiting: int
    def __init__(self, source_host_id: _Optional[bytes] = ..., staleness_nanos: _Optional[int] = ..., source_next_seq: _Optional[int] = ..., missed: _Optional[int] = ..., ready: bool = ..., reconnects: _Optional[int] = ..., waiting: _Optional[int] = ...) -> None: ...

class FedCopyStatus(_message.Message):
    __slots__ = ("host_id", "waiting", "subscriptions", "heard_ago_nanos", "ready", "in_sync", "replica")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    WAITING_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIPTIONS_FIELD_NUMBER: _ClassVar[int]
    HEARD_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    READY_FIELD_NUMBER: _ClassVar[int]
    IN_SYNC_FIELD_NUMBER: _ClassVar[int]
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    waiting: int
    subscriptions: int
    heard_ago_nanos: int
    ready: bool
    in_sync: bool
    replica: bool
    def __init__(self, host_id: _Optional[bytes] = ..., waiting: _Optional[int] = ..., subscriptions: _Optional[int] = ..., heard_ago_nanos: _Optional[int] = ..., ready: bool = ..., in_sync: bool = ..., replica: bool = ...) -> None: ...

class ConsumerStatus(_message.Message):
    __slots__ = ("consumer_id", "lease_nanos", "waiting")
    CONSUMER_ID_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    WAITING_FIELD_NUMBER: _ClassVar[int]
    consumer_id: int
    lease_nanos: int
    waiting: int
    def __init__(self, consumer_id: _Optional[int] = ..., lease_nanos: _Optional[int] = ..., waiting: _Optional[int] = ...) -> None: ...
