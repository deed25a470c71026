from stampede_rt.v1 import quota_pb2 as _quota_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ListQuotaUseRequest(_message.Message):
    __slots__ = ("subject_glob",)
    SUBJECT_GLOB_FIELD_NUMBER: _ClassVar[int]
    subject_glob: str
    def __init__(self, subject_glob: _Optional[str] = ...) -> None: ...

class ListQuotaUseResponse(_message.Message):
    __slots__ = ("uses",)
    USES_FIELD_NUMBER: _ClassVar[int]
    uses: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaUse]
    def __init__(self, uses: _Optional[_Iterable[_Union[_quota_pb2.QuotaUse, _Mapping]]] = ...) -> None: ...
