from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MetaTime(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    META_TIME_UNSPECIFIED: _ClassVar[MetaTime]
    META_TIME_NOW: _ClassVar[MetaTime]
    META_TIME_NEWEST: _ClassVar[MetaTime]
    META_TIME_OLDEST: _ClassVar[MetaTime]

class Match(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    MATCH_UNSPECIFIED: _ClassVar[Match]
    MATCH_SPAN: _ClassVar[Match]
    MATCH_WHOLE: _ClassVar[Match]
    MATCH_START: _ClassVar[Match]
META_TIME_UNSPECIFIED: MetaTime
META_TIME_NOW: MetaTime
META_TIME_NEWEST: MetaTime
META_TIME_OLDEST: MetaTime
MATCH_UNSPECIFIED: Match
MATCH_SPAN: Match
MATCH_WHOLE: Match
MATCH_START: Match

class Bound(_message.Message):
    __slots__ = ("instant_unix_nano", "meta_time", "offset_nanos", "exclusive")
    INSTANT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    META_TIME_FIELD_NUMBER: _ClassVar[int]
    OFFSET_NANOS_FIELD_NUMBER: _ClassVar[int]
    EXCLUSIVE_FIELD_NUMBER: _ClassVar[int]
    instant_unix_nano: int
    meta_time: MetaTime
    offset_nanos: int
    exclusive: bool
    def __init__(self, instant_unix_nano: _Optional[int] = ..., meta_time: _Optional[_Union[MetaTime, str]] = ..., offset_nanos: _Optional[int] = ..., exclusive: bool = ...) -> None: ...

class Interval(_message.Message):
    __slots__ = ("start", "end")
    START_FIELD_NUMBER: _ClassVar[int]
    END_FIELD_NUMBER: _ClassVar[int]
    start: Bound
    end: Bound
    def __init__(self, start: _Optional[_Union[Bound, _Mapping]] = ..., end: _Optional[_Union[Bound, _Mapping]] = ...) -> None: ...

class ResolvedInterval(_message.Message):
    __slots__ = ("start_unix_nano", "end_unix_nano", "start_exclusive", "end_exclusive")
    START_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    END_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    START_EXCLUSIVE_FIELD_NUMBER: _ClassVar[int]
    END_EXCLUSIVE_FIELD_NUMBER: _ClassVar[int]
    start_unix_nano: int
    end_unix_nano: int
    start_exclusive: bool
    end_exclusive: bool
    def __init__(self, start_unix_nano: _Optional[int] = ..., end_unix_nano: _Optional[int] = ..., start_exclusive: bool = ..., end_exclusive: bool = ...) -> None: ...
