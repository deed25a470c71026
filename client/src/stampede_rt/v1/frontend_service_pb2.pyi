from stampede_rt.v1 import access_pb2 as _access_pb2
from stampede_rt.v1 import directory_pb2 as _directory_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class BindRequest(_message.Message):
    __slots__ = ("peer_name", "zone", "protocol_version", "version")
    PEER_NAME_FIELD_NUMBER: _ClassVar[int]
    ZONE_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    peer_name: str
    zone: str
    protocol_version: int
    version: str
    def __init__(self, peer_name: _Optional[str] = ..., zone: _Optional[str] = ..., protocol_version: _Optional[int] = ..., version: _Optional[str] = ...) -> None: ...

class BindResponse(_message.Message):
    __slots__ = ("supernodes", "cluster_id", "protocol_version", "version", "time_unix_nano", "former_cluster_ids", "access")
    SUPERNODES_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FORMER_CLUSTER_IDS_FIELD_NUMBER: _ClassVar[int]
    ACCESS_FIELD_NUMBER: _ClassVar[int]
    supernodes: _containers.RepeatedCompositeFieldContainer[_directory_pb2.SupernodeRecord]
    cluster_id: str
    protocol_version: int
    version: str
    time_unix_nano: int
    former_cluster_ids: _containers.RepeatedScalarFieldContainer[str]
    access: _access_pb2.AccessStatus
    def __init__(self, supernodes: _Optional[_Iterable[_Union[_directory_pb2.SupernodeRecord, _Mapping]]] = ..., cluster_id: _Optional[str] = ..., protocol_version: _Optional[int] = ..., version: _Optional[str] = ..., time_unix_nano: _Optional[int] = ..., former_cluster_ids: _Optional[_Iterable[str]] = ..., access: _Optional[_Union[_access_pb2.AccessStatus, _Mapping]] = ...) -> None: ...
