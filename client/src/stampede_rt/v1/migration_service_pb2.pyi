from stampede_rt.v1 import channel_pb2 as _channel_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DrainHostRequest(_message.Message):
    __slots__ = ("timeout_nanos",)
    TIMEOUT_NANOS_FIELD_NUMBER: _ClassVar[int]
    timeout_nanos: int
    def __init__(self, timeout_nanos: _Optional[int] = ...) -> None: ...

class DrainHostResponse(_message.Message):
    __slots__ = ("moved", "left", "left_count")
    MOVED_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    LEFT_COUNT_FIELD_NUMBER: _ClassVar[int]
    moved: int
    left: _containers.RepeatedCompositeFieldContainer[ChannelNotMoved]
    left_count: int
    def __init__(self, moved: _Optional[int] = ..., left: _Optional[_Iterable[_Union[ChannelNotMoved, _Mapping]]] = ..., left_count: _Optional[int] = ...) -> None: ...

class ChannelNotMoved(_message.Message):
    __slots__ = ("name", "reason")
    NAME_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    name: str
    reason: str
    def __init__(self, name: _Optional[str] = ..., reason: _Optional[str] = ...) -> None: ...

class MoveHereRequest(_message.Message):
    __slots__ = ("channel_id",)
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    def __init__(self, channel_id: _Optional[bytes] = ...) -> None: ...

class MoveHereResponse(_message.Message):
    __slots__ = ("channel", "held", "held_bytes", "blackout_nanos")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    HELD_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    BLACKOUT_NANOS_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    held: int
    held_bytes: int
    blackout_nanos: int
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., held: _Optional[int] = ..., held_bytes: _Optional[int] = ..., blackout_nanos: _Optional[int] = ...) -> None: ...
