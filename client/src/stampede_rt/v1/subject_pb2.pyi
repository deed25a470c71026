from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class Subject(_message.Message):
    __slots__ = ("channel_id", "queue_id")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    queue_id: bytes
    def __init__(self, channel_id: _Optional[bytes] = ..., queue_id: _Optional[bytes] = ...) -> None: ...

class SeqRange(_message.Message):
    __slots__ = ("first_seq", "items")
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    first_seq: int
    items: int
    def __init__(self, first_seq: _Optional[int] = ..., items: _Optional[int] = ...) -> None: ...
