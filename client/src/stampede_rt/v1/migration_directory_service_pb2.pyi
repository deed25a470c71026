from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import move_pb2 as _move_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CommitMoveRequest(_message.Message):
    __slots__ = ("request_id", "channel_id", "epoch", "to_host_id", "to_boot_incarnation", "permit", "to_registered_index")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    TO_REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    channel_id: bytes
    epoch: int
    to_host_id: bytes
    to_boot_incarnation: int
    permit: bytes
    to_registered_index: int
    def __init__(self, request_id: _Optional[bytes] = ..., channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., permit: _Optional[bytes] = ..., to_registered_index: _Optional[int] = ...) -> None: ...

class CommitMovesRequest(_message.Message):
    __slots__ = ("request_id", "to_host_id", "to_boot_incarnation", "moves", "to_registered_index")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    MOVES_FIELD_NUMBER: _ClassVar[int]
    TO_REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    to_host_id: bytes
    to_boot_incarnation: int
    moves: _containers.RepeatedCompositeFieldContainer[_move_pb2.MoveToCommit]
    to_registered_index: int
    def __init__(self, request_id: _Optional[bytes] = ..., to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., moves: _Optional[_Iterable[_Union[_move_pb2.MoveToCommit, _Mapping]]] = ..., to_registered_index: _Optional[int] = ...) -> None: ...

class CommitMovesResponse(_message.Message):
    __slots__ = ("channels",)
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    def __init__(self, channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ...) -> None: ...

class ReleaseMovesRequest(_message.Message):
    __slots__ = ("request_id", "host_id", "moves")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    MOVES_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    host_id: bytes
    moves: _containers.RepeatedCompositeFieldContainer[_move_pb2.MoveToRelease]
    def __init__(self, request_id: _Optional[bytes] = ..., host_id: _Optional[bytes] = ..., moves: _Optional[_Iterable[_Union[_move_pb2.MoveToRelease, _Mapping]]] = ...) -> None: ...

class ReleaseMovesResponse(_message.Message):
    __slots__ = ("channel_ids",)
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class ListReleasedMovesRequest(_message.Message):
    __slots__ = ("host_id", "channel_ids")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, host_id: _Optional[bytes] = ..., channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class ListReleasedMovesResponse(_message.Message):
    __slots__ = ("channel_ids",)
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class ListOwnersRequest(_message.Message):
    __slots__ = ("channel_ids",)
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class ListOwnersResponse(_message.Message):
    __slots__ = ("channels", "hosts")
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    def __init__(self, channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ...) -> None: ...

class CommitQueueMoveRequest(_message.Message):
    __slots__ = ("request_id", "queue_id", "epoch", "to_host_id", "to_boot_incarnation", "permit", "to_registered_index")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    TO_REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    queue_id: bytes
    epoch: int
    to_host_id: bytes
    to_boot_incarnation: int
    permit: bytes
    to_registered_index: int
    def __init__(self, request_id: _Optional[bytes] = ..., queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., permit: _Optional[bytes] = ..., to_registered_index: _Optional[int] = ...) -> None: ...

class CommitQueueMoveResponse(_message.Message):
    __slots__ = ("queue",)
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class CommitMoveResponse(_message.Message):
    __slots__ = ("channel",)
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ...) -> None: ...
