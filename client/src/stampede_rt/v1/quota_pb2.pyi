from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class QuotaKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    QUOTA_KIND_UNSPECIFIED: _ClassVar[QuotaKind]
    QUOTA_KIND_STREAMS: _ClassVar[QuotaKind]
    QUOTA_KIND_SUBSCRIPTIONS: _ClassVar[QuotaKind]
    QUOTA_KIND_WAITING_CALLS: _ClassVar[QuotaKind]
    QUOTA_KIND_BYTES_IN_FLIGHT: _ClassVar[QuotaKind]
    QUOTA_KIND_CHANNELS: _ClassVar[QuotaKind]
    QUOTA_KIND_QUEUES: _ClassVar[QuotaKind]
    QUOTA_KIND_CHANGES_PER_SECOND: _ClassVar[QuotaKind]
    QUOTA_KIND_BYTES_HELD: _ClassVar[QuotaKind]
    QUOTA_KIND_CPU_PERCENT: _ClassVar[QuotaKind]
    QUOTA_KIND_GROUPS: _ClassVar[QuotaKind]
    QUOTA_KIND_PEERS: _ClassVar[QuotaKind]
    QUOTA_KIND_BYTES_ARCHIVED: _ClassVar[QuotaKind]
QUOTA_KIND_UNSPECIFIED: QuotaKind
QUOTA_KIND_STREAMS: QuotaKind
QUOTA_KIND_SUBSCRIPTIONS: QuotaKind
QUOTA_KIND_WAITING_CALLS: QuotaKind
QUOTA_KIND_BYTES_IN_FLIGHT: QuotaKind
QUOTA_KIND_CHANNELS: QuotaKind
QUOTA_KIND_QUEUES: QuotaKind
QUOTA_KIND_CHANGES_PER_SECOND: QuotaKind
QUOTA_KIND_BYTES_HELD: QuotaKind
QUOTA_KIND_CPU_PERCENT: QuotaKind
QUOTA_KIND_GROUPS: QuotaKind
QUOTA_KIND_PEERS: QuotaKind
QUOTA_KIND_BYTES_ARCHIVED: QuotaKind

class QuotaSetting(_message.Message):
    __slots__ = ("who", "kind", "limit")
    WHO_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    who: str
    kind: QuotaKind
    limit: int
    def __init__(self, who: _Optional[str] = ..., kind: _Optional[_Union[QuotaKind, str]] = ..., limit: _Optional[int] = ...) -> None: ...

class QuotaLimit(_message.Message):
    __slots__ = ("kind", "limit", "setting")
    KIND_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    SETTING_FIELD_NUMBER: _ClassVar[int]
    kind: QuotaKind
    limit: int
    setting: QuotaSetting
    def __init__(self, kind: _Optional[_Union[QuotaKind, str]] = ..., limit: _Optional[int] = ..., setting: _Optional[_Union[QuotaSetting, _Mapping]] = ...) -> None: ...

class QuotaUse(_message.Message):
    __slots__ = ("subject", "kind", "used", "limit", "refused")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    USED_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    subject: str
    kind: QuotaKind
    used: int
    limit: int
    refused: int
    def __init__(self, subject: _Optional[str] = ..., kind: _Optional[_Union[QuotaKind, str]] = ..., used: _Optional[int] = ..., limit: _Optional[int] = ..., refused: _Optional[int] = ...) -> None: ...
