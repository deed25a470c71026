from stampede_rt.v1 import directory_pb2 as _directory_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CreateJoinTokenRequest(_message.Message):
    __slots__ = ("request_id", "valid_nanos", "supernode_id", "target")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    VALID_NANOS_FIELD_NUMBER: _ClassVar[int]
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    TARGET_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    valid_nanos: int
    supernode_id: str
    target: str
    def __init__(self, request_id: _Optional[bytes] = ..., valid_nanos: _Optional[int] = ..., supernode_id: _Optional[str] = ..., target: _Optional[str] = ...) -> None: ...

class CreateJoinTokenResponse(_message.Message):
    __slots__ = ("token", "valid_until_unix_nano", "cluster_id", "log_cluster_id")
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    VALID_UNTIL_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    LOG_CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    token: str
    valid_until_unix_nano: int
    cluster_id: str
    log_cluster_id: str
    def __init__(self, token: _Optional[str] = ..., valid_until_unix_nano: _Optional[int] = ..., cluster_id: _Optional[str] = ..., log_cluster_id: _Optional[str] = ...) -> None: ...

class AddSupernodeRequest(_message.Message):
    __slots__ = ("supernode_id", "endpoint", "token", "protocol_version", "version", "highest_feature_level")
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    ENDPOINT_FIELD_NUMBER: _ClassVar[int]
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    HIGHEST_FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    supernode_id: str
    endpoint: _directory_pb2.Endpoint
    token: str
    protocol_version: int
    version: str
    highest_feature_level: int
    def __init__(self, supernode_id: _Optional[str] = ..., endpoint: _Optional[_Union[_directory_pb2.Endpoint, _Mapping]] = ..., token: _Optional[str] = ..., protocol_version: _Optional[int] = ..., version: _Optional[str] = ..., highest_feature_level: _Optional[int] = ...) -> None: ...

class AddSupernodeResponse(_message.Message):
    __slots__ = ("supernodes", "cluster_id", "index")
    SUPERNODES_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    supernodes: _containers.RepeatedCompositeFieldContainer[_directory_pb2.SupernodeRecord]
    cluster_id: str
    index: int
    def __init__(self, supernodes: _Optional[_Iterable[_Union[_directory_pb2.SupernodeRecord, _Mapping]]] = ..., cluster_id: _Optional[str] = ..., index: _Optional[int] = ...) -> None: ...

class RemoveSupernodeRequest(_message.Message):
    __slots__ = ("supernode_id",)
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    supernode_id: str
    def __init__(self, supernode_id: _Optional[str] = ...) -> None: ...

class RemoveSupernodeResponse(_message.Message):
    __slots__ = ("supernodes", "index")
    SUPERNODES_FIELD_NUMBER: _ClassVar[int]
    INDEX_FIELD_NUMBER: _ClassVar[int]
    supernodes: _containers.RepeatedCompositeFieldContainer[_directory_pb2.SupernodeRecord]
    index: int
    def __init__(self, supernodes: _Optional[_Iterable[_Union[_directory_pb2.SupernodeRecord, _Mapping]]] = ..., index: _Optional[int] = ...) -> None: ...

class TakeSnapshotRequest(_message.Message):
    __slots__ = ("include_data", "stale_ok")
    INCLUDE_DATA_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    include_data: bool
    stale_ok: bool
    def __init__(self, include_data: bool = ..., stale_ok: bool = ...) -> None: ...

class TakeSnapshotResponse(_message.Message):
    __slots__ = ("supernode_id", "log_index", "size_bytes", "sha256", "time_unix_nano", "took_nanos", "data")
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    SIZE_BYTES_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    TOOK_NANOS_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    supernode_id: str
    log_index: int
    size_bytes: int
    sha256: bytes
    time_unix_nano: int
    took_nanos: int
    data: bytes
    def __init__(self, supernode_id: _Optional[str] = ..., log_index: _Optional[int] = ..., size_bytes: _Optional[int] = ..., sha256: _Optional[bytes] = ..., time_unix_nano: _Optional[int] = ..., took_nanos: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...
