from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class MoveToCommit(_message.Message):
    __slots__ = ("channel_id", "epoch", "permit")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    permit: bytes
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., permit: _Optional[bytes] = ...) -> None: ...

class MoveToRelease(_message.Message):
    __slots__ = ("channel_id", "epoch")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...
