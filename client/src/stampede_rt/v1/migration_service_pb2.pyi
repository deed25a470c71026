from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import migration_pb2 as _migration_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class MoveHereRequest(_message.Message):
    __slots__ = ("request_id", "subject", "epoch")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    subject: _subject_pb2.Subject
    epoch: int
    def __init__(self, request_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ...) -> None: ...

class MoveHereResponse(_message.Message):
    __slots__ = ("move", "channel", "queue")
    MOVE_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    move: _migration_pb2.MoveRecord
    channel: _channel_pb2.ChannelRecord
    queue: _queue_pb2.QueueRecord
    def __init__(self, move: _Optional[_Union[_migration_pb2.MoveRecord, _Mapping]] = ..., channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class OfferSubjectsRequest(_message.Message):
    __slots__ = ("from_host_id", "subjects")
    FROM_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECTS_FIELD_NUMBER: _ClassVar[int]
    from_host_id: bytes
    subjects: _containers.RepeatedCompositeFieldContainer[OfferedSubject]
    def __init__(self, from_host_id: _Optional[bytes] = ..., subjects: _Optional[_Iterable[_Union[OfferedSubject, _Mapping]]] = ...) -> None: ...

class OfferedSubject(_message.Message):
    __slots__ = ("subject", "epoch", "held_bytes", "accepted_bytes_per_second")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_BYTES_PER_SECOND_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    epoch: int
    held_bytes: int
    accepted_bytes_per_second: int
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., held_bytes: _Optional[int] = ..., accepted_bytes_per_second: _Optional[int] = ...) -> None: ...

class OfferSubjectsResponse(_message.Message):
    __slots__ = ("subjects",)
    SUBJECTS_FIELD_NUMBER: _ClassVar[int]
    subjects: _containers.RepeatedCompositeFieldContainer[_subject_pb2.Subject]
    def __init__(self, subjects: _Optional[_Iterable[_Union[_subject_pb2.Subject, _Mapping]]] = ...) -> None: ...

class HoldSubjectRequest(_message.Message):
    __slots__ = ("move_id", "subject", "epoch", "to_host_id")
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    move_id: bytes
    subject: _subject_pb2.Subject
    epoch: int
    to_host_id: bytes
    def __init__(self, move_id: _Optional[bytes] = ..., subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., to_host_id: _Optional[bytes] = ...) -> None: ...

class HoldSubjectResponse(_message.Message):
    __slots__ = ("handoff", "last")
    HANDOFF_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    handoff: _migration_pb2.HandoffRecord
    last: bool
    def __init__(self, handoff: _Optional[_Union[_migration_pb2.HandoffRecord, _Mapping]] = ..., last: bool = ...) -> None: ...

class ReleaseSubjectRequest(_message.Message):
    __slots__ = ("move_id", "to_host_id", "epoch")
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    move_id: bytes
    to_host_id: bytes
    epoch: int
    def __init__(self, move_id: _Optional[bytes] = ..., to_host_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class ReleaseSubjectResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...
