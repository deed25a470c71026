from stampede_rt.v1 import quota_pb2 as _quota_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class SetQuotasRequest(_message.Message):
    __slots__ = ("request_id", "settings")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SETTINGS_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    settings: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaSetting]
    def __init__(self, request_id: _Optional[bytes] = ..., settings: _Optional[_Iterable[_Union[_quota_pb2.QuotaSetting, _Mapping]]] = ...) -> None: ...

class SetQuotasResponse(_message.Message):
    __slots__ = ("changed", "version")
    CHANGED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    changed: bool
    version: int
    def __init__(self, changed: bool = ..., version: _Optional[int] = ...) -> None: ...

class RemoveQuotasRequest(_message.Message):
    __slots__ = ("request_id", "who", "kinds")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    WHO_FIELD_NUMBER: _ClassVar[int]
    KINDS_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    who: str
    kinds: _containers.RepeatedScalarFieldContainer[_quota_pb2.QuotaKind]
    def __init__(self, request_id: _Optional[bytes] = ..., who: _Optional[str] = ..., kinds: _Optional[_Iterable[_Union[_quota_pb2.QuotaKind, str]]] = ...) -> None: ...

class RemoveQuotasResponse(_message.Message):
    __slots__ = ("removed", "version")
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    removed: int
    version: int
    def __init__(self, removed: _Optional[int] = ..., version: _Optional[int] = ...) -> None: ...

class ListQuotasRequest(_message.Message):
    __slots__ = ("stale_ok",)
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    stale_ok: bool
    def __init__(self, stale_ok: bool = ...) -> None: ...

class ListQuotasResponse(_message.Message):
    __slots__ = ("settings", "defaults")
    SETTINGS_FIELD_NUMBER: _ClassVar[int]
    DEFAULTS_FIELD_NUMBER: _ClassVar[int]
    settings: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaSetting]
    defaults: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaLimit]
    def __init__(self, settings: _Optional[_Iterable[_Union[_quota_pb2.QuotaSetting, _Mapping]]] = ..., defaults: _Optional[_Iterable[_Union[_quota_pb2.QuotaLimit, _Mapping]]] = ...) -> None: ...

class CheckQuotasRequest(_message.Message):
    __slots__ = ("subject",)
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    subject: str
    def __init__(self, subject: _Optional[str] = ...) -> None: ...

class CheckQuotasResponse(_message.Message):
    __slots__ = ("limits",)
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    limits: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaLimit]
    def __init__(self, limits: _Optional[_Iterable[_Union[_quota_pb2.QuotaLimit, _Mapping]]] = ...) -> None: ...
