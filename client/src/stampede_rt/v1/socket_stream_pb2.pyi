from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class StreamOpening(_message.Message):
    __slots__ = ("method", "protocol_version", "cluster_id", "authorization", "ticket", "trace_parent")
    METHOD_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    AUTHORIZATION_FIELD_NUMBER: _ClassVar[int]
    TICKET_FIELD_NUMBER: _ClassVar[int]
    TRACE_PARENT_FIELD_NUMBER: _ClassVar[int]
    method: str
    protocol_version: int
    cluster_id: str
    authorization: str
    ticket: bytes
    trace_parent: str
    def __init__(self, method: _Optional[str] = ..., protocol_version: _Optional[int] = ..., cluster_id: _Optional[str] = ..., authorization: _Optional[str] = ..., ticket: _Optional[bytes] = ..., trace_parent: _Optional[str] = ...) -> None: ...
