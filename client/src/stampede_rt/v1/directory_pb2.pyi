from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import group_pb2 as _group_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ChangeKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CHANGE_KIND_UNSPECIFIED: _ClassVar[ChangeKind]
    CHANGE_KIND_ADDED: _ClassVar[ChangeKind]
    CHANGE_KIND_UPDATED: _ClassVar[ChangeKind]
    CHANGE_KIND_REMOVED: _ClassVar[ChangeKind]
CHANGE_KIND_UNSPECIFIED: ChangeKind
CHANGE_KIND_ADDED: ChangeKind
CHANGE_KIND_UPDATED: ChangeKind
CHANGE_KIND_REMOVED: ChangeKind

class Endpoint(_message.Message):
    __slots__ = ("target", "zone")
    TARGET_FIELD_NUMBER: _ClassVar[int]
    ZONE_FIELD_NUMBER: _ClassVar[int]
    target: str
    zone: str
    def __init__(self, target: _Optional[str] = ..., zone: _Optional[str] = ...) -> None: ...

class HostLoad(_message.Message):
    __slots__ = ("busy_permille", "held_bytes", "bytes_max", "owned", "has_archive", "private", "machine")
    BUSY_PERMILLE_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    BYTES_MAX_FIELD_NUMBER: _ClassVar[int]
    OWNED_FIELD_NUMBER: _ClassVar[int]
    HAS_ARCHIVE_FIELD_NUMBER: _ClassVar[int]
    PRIVATE_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    busy_permille: int
    held_bytes: int
    bytes_max: int
    owned: int
    has_archive: bool
    private: bool
    machine: str
    def __init__(self, busy_permille: _Optional[int] = ..., held_bytes: _Optional[int] = ..., bytes_max: _Optional[int] = ..., owned: _Optional[int] = ..., has_archive: bool = ..., private: bool = ..., machine: _Optional[str] = ...) -> None: ...

class HostRecord(_message.Message):
    __slots__ = ("host_id", "name", "gatekeepers", "boot_incarnation", "alive", "channels", "version", "lease_ended_unix_nano", "registration_epoch", "load", "archive_place")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    GATEKEEPERS_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    ALIVE_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    LEASE_ENDED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_EPOCH_FIELD_NUMBER: _ClassVar[int]
    LOAD_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_PLACE_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    name: str
    gatekeepers: _containers.RepeatedCompositeFieldContainer[Endpoint]
    boot_incarnation: int
    alive: bool
    channels: int
    version: str
    lease_ended_unix_nano: int
    registration_epoch: int
    load: HostLoad
    archive_place: str
    def __init__(self, host_id: _Optional[bytes] = ..., name: _Optional[str] = ..., gatekeepers: _Optional[_Iterable[_Union[Endpoint, _Mapping]]] = ..., boot_incarnation: _Optional[int] = ..., alive: bool = ..., channels: _Optional[int] = ..., version: _Optional[str] = ..., lease_ended_unix_nano: _Optional[int] = ..., registration_epoch: _Optional[int] = ..., load: _Optional[_Union[HostLoad, _Mapping]] = ..., archive_place: _Optional[str] = ...) -> None: ...

class SupernodeRecord(_message.Message):
    __slots__ = ("supernode_id", "endpoint", "is_leader", "healthy", "round_trip_nanos", "highest_feature_level")
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    ENDPOINT_FIELD_NUMBER: _ClassVar[int]
    IS_LEADER_FIELD_NUMBER: _ClassVar[int]
    HEALTHY_FIELD_NUMBER: _ClassVar[int]
    ROUND_TRIP_NANOS_FIELD_NUMBER: _ClassVar[int]
    HIGHEST_FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    supernode_id: str
    endpoint: Endpoint
    is_leader: bool
    healthy: bool
    round_trip_nanos: int
    highest_feature_level: int
    def __init__(self, supernode_id: _Optional[str] = ..., endpoint: _Optional[_Union[Endpoint, _Mapping]] = ..., is_leader: bool = ..., healthy: bool = ..., round_trip_nanos: _Optional[int] = ..., highest_feature_level: _Optional[int] = ...) -> None: ...

class DirectoryChange(_message.Message):
    __slots__ = ("index", "kind", "channel", "host", "group", "queue", "access")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    GROUP_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    ACCESS_FIELD_NUMBER: _ClassVar[int]
    index: int
    kind: ChangeKind
    channel: _channel_pb2.ChannelRecord
    host: HostRecord
    group: _group_pb2.GroupRecord
    queue: _queue_pb2.QueueRecord
    access: AccessChange
    def __init__(self, index: _Optional[int] = ..., kind: _Optional[_Union[ChangeKind, str]] = ..., channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., host: _Optional[_Union[HostRecord, _Mapping]] = ..., group: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ..., queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., access: _Optional[_Union[AccessChange, _Mapping]] = ...) -> None: ...

class AccessChange(_message.Message):
    __slots__ = ("version",)
    VERSION_FIELD_NUMBER: _ClassVar[int]
    version: int
    def __init__(self, version: _Optional[int] = ...) -> None: ...
