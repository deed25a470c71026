from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import migration_pb2 as _migration_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class PrepareMoveRequest(_message.Message):
    __slots__ = ("move",)
    MOVE_FIELD_NUMBER: _ClassVar[int]
    move: _migration_pb2.MoveRecord
    def __init__(self, move: _Optional[_Union[_migration_pb2.MoveRecord, _Mapping]] = ...) -> None: ...

class PrepareMoveResponse(_message.Message):
    __slots__ = ("move",)
    MOVE_FIELD_NUMBER: _ClassVar[int]
    move: _migration_pb2.MoveRecord
    def __init__(self, move: _Optional[_Union[_migration_pb2.MoveRecord, _Mapping]] = ...) -> None: ...

class CommitMoveRequest(_message.Message):
    __slots__ = ("move_id", "to_boot_incarnation")
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    move_id: bytes
    to_boot_incarnation: int
    def __init__(self, move_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ...) -> None: ...

class CommitMoveResponse(_message.Message):
    __slots__ = ("move", "channel", "queue")
    MOVE_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    move: _migration_pb2.MoveRecord
    channel: _channel_pb2.ChannelRecord
    queue: _queue_pb2.QueueRecord
    def __init__(self, move: _Optional[_Union[_migration_pb2.MoveRecord, _Mapping]] = ..., channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class AbortMoveRequest(_message.Message):
    __slots__ = ("move_id", "reason")
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    move_id: bytes
    reason: str
    def __init__(self, move_id: _Optional[bytes] = ..., reason: _Optional[str] = ...) -> None: ...

class AbortMoveResponse(_message.Message):
    __slots__ = ("move",)
    MOVE_FIELD_NUMBER: _ClassVar[int]
    move: _migration_pb2.MoveRecord
    def __init__(self, move: _Optional[_Union[_migration_pb2.MoveRecord, _Mapping]] = ...) -> None: ...

class GetMoveRequest(_message.Message):
    __slots__ = ("move_id",)
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    move_id: bytes
    def __init__(self, move_id: _Optional[bytes] = ...) -> None: ...

class GetMoveResponse(_message.Message):
    __slots__ = ("move", "applied_index")
    MOVE_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    move: _migration_pb2.MoveRecord
    applied_index: int
    def __init__(self, move: _Optional[_Union[_migration_pb2.MoveRecord, _Mapping]] = ..., applied_index: _Optional[int] = ...) -> None: ...

class ListMovesRequest(_message.Message):
    __slots__ = ("host_id", "page_size", "page_token")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    page_size: int
    page_token: str
    def __init__(self, host_id: _Optional[bytes] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListMovesResponse(_message.Message):
    __slots__ = ("moves", "hosts", "next_page_token", "applied_index")
    MOVES_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    moves: _containers.RepeatedCompositeFieldContainer[_migration_pb2.MoveRecord]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    next_page_token: str
    applied_index: int
    def __init__(self, moves: _Optional[_Iterable[_Union[_migration_pb2.MoveRecord, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., applied_index: _Optional[int] = ...) -> None: ...
