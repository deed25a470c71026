from stampede_rt.v1 import directory_pb2 as _directory_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PeerRecord(_message.Message):
    __slots__ = ("peer_id", "name", "boot_incarnation", "alive", "mailbox_queue_id", "host_id", "zone", "version", "attributes", "registered_unix_nano", "clock", "registration_epoch", "owner")
    class AttributesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    ALIVE_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    ZONE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_EPOCH_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    peer_id: bytes
    name: str
    boot_incarnation: int
    alive: bool
    mailbox_queue_id: bytes
    host_id: bytes
    zone: str
    version: str
    attributes: _containers.ScalarMap[str, str]
    registered_unix_nano: int
    clock: ClockOffset
    registration_epoch: int
    owner: str
    def __init__(self, peer_id: _Optional[bytes] = ..., name: _Optional[str] = ..., boot_incarnation: _Optional[int] = ..., alive: bool = ..., mailbox_queue_id: _Optional[bytes] = ..., host_id: _Optional[bytes] = ..., zone: _Optional[str] = ..., version: _Optional[str] = ..., attributes: _Optional[_Mapping[str, str]] = ..., registered_unix_nano: _Optional[int] = ..., clock: _Optional[_Union[ClockOffset, _Mapping]] = ..., registration_epoch: _Optional[int] = ..., owner: _Optional[str] = ...) -> None: ...

class ClockOffset(_message.Message):
    __slots__ = ("offset_nanos", "uncertainty_nanos", "supernode_id")
    OFFSET_NANOS_FIELD_NUMBER: _ClassVar[int]
    UNCERTAINTY_NANOS_FIELD_NUMBER: _ClassVar[int]
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    offset_nanos: int
    uncertainty_nanos: int
    supernode_id: str
    def __init__(self, offset_nanos: _Optional[int] = ..., uncertainty_nanos: _Optional[int] = ..., supernode_id: _Optional[str] = ...) -> None: ...

class PeerChange(_message.Message):
    __slots__ = ("index", "kind", "peer")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    PEER_FIELD_NUMBER: _ClassVar[int]
    index: int
    kind: _directory_pb2.ChangeKind
    peer: PeerRecord
    def __init__(self, index: _Optional[int] = ..., kind: _Optional[_Union[_directory_pb2.ChangeKind, str]] = ..., peer: _Optional[_Union[PeerRecord, _Mapping]] = ...) -> None: ...
