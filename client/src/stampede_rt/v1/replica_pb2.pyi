from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ReplicaKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    REPLICA_KIND_UNSPECIFIED: _ClassVar[ReplicaKind]
    REPLICA_KIND_PROXY: _ClassVar[ReplicaKind]
    REPLICA_KIND_WARM: _ClassVar[ReplicaKind]
    REPLICA_KIND_MOVE: _ClassVar[ReplicaKind]
REPLICA_KIND_UNSPECIFIED: ReplicaKind
REPLICA_KIND_PROXY: ReplicaKind
REPLICA_KIND_WARM: ReplicaKind
REPLICA_KIND_MOVE: ReplicaKind

class ReplicaRecord(_message.Message):
    __slots__ = ("subject", "host_id", "boot_incarnation", "kind", "source_host_id", "in_sync", "acknowledged", "epoch", "change_number", "added_index")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SOURCE_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    IN_SYNC_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    CHANGE_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ADDED_INDEX_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    host_id: bytes
    boot_incarnation: int
    kind: ReplicaKind
    source_host_id: bytes
    in_sync: bool
    acknowledged: bool
    epoch: int
    change_number: int
    added_index: int
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., kind: _Optional[_Union[ReplicaKind, str]] = ..., source_host_id: _Optional[bytes] = ..., in_sync: bool = ..., acknowledged: bool = ..., epoch: _Optional[int] = ..., change_number: _Optional[int] = ..., added_index: _Optional[int] = ...) -> None: ...

class ReplicaLoad(_message.Message):
    __slots__ = ("subject", "host_id", "subscriptions", "delivered_bytes_per_second", "next_seq", "lag_nanos")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIPTIONS_FIELD_NUMBER: _ClassVar[int]
    DELIVERED_BYTES_PER_SECOND_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    LAG_NANOS_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    host_id: bytes
    subscriptions: int
    delivered_bytes_per_second: int
    next_seq: int
    lag_nanos: int
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., host_id: _Optional[bytes] = ..., subscriptions: _Optional[int] = ..., delivered_bytes_per_second: _Optional[int] = ..., next_seq: _Optional[int] = ..., lag_nanos: _Optional[int] = ...) -> None: ...
