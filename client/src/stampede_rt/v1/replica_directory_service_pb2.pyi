from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import replica_pb2 as _replica_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class AddReplicaRequest(_message.Message):
    __slots__ = ("request_id", "subject", "epoch", "host_id", "kind", "source_host_id", "acknowledged")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SOURCE_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    subject: _subject_pb2.Subject
    epoch: int
    host_id: bytes
    kind: _replica_pb2.ReplicaKind
    source_host_id: bytes
    acknowledged: bool
    def __init__(self, request_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., kind: _Optional[_Union[_replica_pb2.ReplicaKind, str]] = ..., source_host_id: _Optional[bytes] = ..., acknowledged: bool = ...) -> None: ...

class AddReplicaResponse(_message.Message):
    __slots__ = ("replica", "host")
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    replica: _replica_pb2.ReplicaRecord
    host: _directory_pb2.HostRecord
    def __init__(self, replica: _Optional[_Union[_replica_pb2.ReplicaRecord, _Mapping]] = ..., host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ...) -> None: ...

class RemoveReplicaRequest(_message.Message):
    __slots__ = ("request_id", "subject", "host_id", "epoch")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    subject: _subject_pb2.Subject
    host_id: bytes
    epoch: int
    def __init__(self, request_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., host_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class RemoveReplicaResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class SetReplicaInSyncRequest(_message.Message):
    __slots__ = ("request_id", "subject", "epoch", "host_id", "boot_incarnation", "in_sync", "change_number", "added_index")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    IN_SYNC_FIELD_NUMBER: _ClassVar[int]
    CHANGE_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ADDED_INDEX_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    subject: _subject_pb2.Subject
    epoch: int
    host_id: bytes
    boot_incarnation: int
    in_sync: bool
    change_number: int
    added_index: int
    def __init__(self, request_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., in_sync: bool = ..., change_number: _Optional[int] = ..., added_index: _Optional[int] = ...) -> None: ...

class SetReplicaInSyncResponse(_message.Message):
    __slots__ = ("replica",)
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    replica: _replica_pb2.ReplicaRecord
    def __init__(self, replica: _Optional[_Union[_replica_pb2.ReplicaRecord, _Mapping]] = ...) -> None: ...

class ReportReplicaLoadsRequest(_message.Message):
    __slots__ = ("host_id", "boot_incarnation", "loads")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    LOADS_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    boot_incarnation: int
    loads: _containers.RepeatedCompositeFieldContainer[_replica_pb2.ReplicaLoad]
    def __init__(self, host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., loads: _Optional[_Iterable[_Union[_replica_pb2.ReplicaLoad, _Mapping]]] = ...) -> None: ...

class ReportReplicaLoadsResponse(_message.Message):
    __slots__ = ("gone_channel_ids",)
    GONE_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    gone_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, gone_channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class ListReplicasRequest(_message.Message):
    __slots__ = ("subject", "stale_ok")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    stale_ok: bool
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., stale_ok: bool = ...) -> None: ...

class ListReplicasResponse(_message.Message):
    __slots__ = ("replicas", "loads", "hosts", "owner_host_id", "epoch", "applied_index")
    REPLICAS_FIELD_NUMBER: _ClassVar[int]
    LOADS_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    OWNER_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    replicas: _containers.RepeatedCompositeFieldContainer[_replica_pb2.ReplicaRecord]
    loads: _containers.RepeatedCompositeFieldContainer[_replica_pb2.ReplicaLoad]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    owner_host_id: bytes
    epoch: int
    applied_index: int
    def __init__(self, replicas: _Optional[_Iterable[_Union[_replica_pb2.ReplicaRecord, _Mapping]]] = ..., loads: _Optional[_Iterable[_Union[_replica_pb2.ReplicaLoad, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., owner_host_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., applied_index: _Optional[int] = ...) -> None: ...
