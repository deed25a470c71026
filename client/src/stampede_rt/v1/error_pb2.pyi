from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ErrorReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ERROR_REASON_UNSPECIFIED: _ClassVar[ErrorReason]
    ERROR_REASON_INVALID_ARGUMENT: _ClassVar[ErrorReason]
    ERROR_REASON_INVALID_INTERVAL: _ClassVar[ErrorReason]
    ERROR_REASON_INVALID_NAME: _ClassVar[ErrorReason]
    ERROR_REASON_MALFORMED_RUN: _ClassVar[ErrorReason]
    ERROR_REASON_ITEM_TOO_LARGE: _ClassVar[ErrorReason]
    ERROR_REASON_CHANNEL_NOT_FOUND: _ClassVar[ErrorReason]
    ERROR_REASON_CHANNEL_EXISTS: _ClassVar[ErrorReason]
    ERROR_REASON_HOST_NOT_FOUND: _ClassVar[ErrorReason]
    ERROR_REASON_HOST_EXISTS: _ClassVar[ErrorReason]
    ERROR_REASON_NO_HOST: _ClassVar[ErrorReason]
    ERROR_REASON_WRONG_EPOCH: _ClassVar[ErrorReason]
    ERROR_REASON_NOT_HERE: _ClassVar[ErrorReason]
    ERROR_REASON_MOVED: _ClassVar[ErrorReason]
    ERROR_REASON_TOO_OLD: _ClassVar[ErrorReason]
    ERROR_REASON_IN_FUTURE: _ClassVar[ErrorReason]
    ERROR_REASON_CHANNEL_FULL: _ClassVar[ErrorReason]
    ERROR_REASON_OVERLOADED: _ClassVar[ErrorReason]
    ERROR_REASON_INCARNATION_LOST: _ClassVar[ErrorReason]
    ERROR_REASON_LEASE_EXPIRED: _ClassVar[ErrorReason]
    ERROR_REASON_NOT_LEADER: _ClassVar[ErrorReason]
    ERROR_REASON_NO_QUORUM: _ClassVar[ErrorReason]
    ERROR_REASON_AMBIGUOUS: _ClassVar[ErrorReason]
    ERROR_REASON_UNAUTHENTICATED: _ClassVar[ErrorReason]
    ERROR_REASON_PERMISSION_DENIED: _ClassVar[ErrorReason]
    ERROR_REASON_VERSION_MISMATCH: _ClassVar[ErrorReason]
    ERROR_REASON_SHUTTING_DOWN: _ClassVar[ErrorReason]
    ERROR_REASON_WATCH_RESTART: _ClassVar[ErrorReason]
    ERROR_REASON_GROUP_NOT_FOUND: _ClassVar[ErrorReason]
    ERROR_REASON_GROUP_EXISTS: _ClassVar[ErrorReason]
    ERROR_REASON_QUEUE_NOT_FOUND: _ClassVar[ErrorReason]
    ERROR_REASON_QUEUE_EXISTS: _ClassVar[ErrorReason]
    ERROR_REASON_PEER_EXISTS: _ClassVar[ErrorReason]
    ERROR_REASON_DEADLINE_EXCEEDED: _ClassVar[ErrorReason]
    ERROR_REASON_INTERNAL: _ClassVar[ErrorReason]
    ERROR_REASON_PEER_NOT_FOUND: _ClassVar[ErrorReason]
    ERROR_REASON_QUEUE_FULL: _ClassVar[ErrorReason]
    ERROR_REASON_MOVE_NOT_FOUND: _ClassVar[ErrorReason]
    ERROR_REASON_MOVE_CONFLICT: _ClassVar[ErrorReason]
    ERROR_REASON_WRONG_CLUSTER: _ClassVar[ErrorReason]
    ERROR_REASON_STALE_REGISTRATION: _ClassVar[ErrorReason]
    ERROR_REASON_CERTIFICATE_EXPIRED: _ClassVar[ErrorReason]
    ERROR_REASON_TOKEN_EXPIRED: _ClassVar[ErrorReason]
    ERROR_REASON_NOT_REPLICATED: _ClassVar[ErrorReason]
    ERROR_REASON_NOT_ARCHIVED: _ClassVar[ErrorReason]
    ERROR_REASON_AHEAD_OF_CLOCK: _ClassVar[ErrorReason]

class AbsenceReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ABSENCE_REASON_UNSPECIFIED: _ClassVar[AbsenceReason]
    ABSENCE_REASON_COLLECTED: _ClassVar[AbsenceReason]
    ABSENCE_REASON_NEVER: _ClassVar[AbsenceReason]
    ABSENCE_REASON_NOT_YET: _ClassVar[AbsenceReason]
    ABSENCE_REASON_HIDDEN: _ClassVar[AbsenceReason]
    ABSENCE_REASON_LOST: _ClassVar[AbsenceReason]
ERROR_REASON_UNSPECIFIED: ErrorReason
ERROR_REASON_INVALID_ARGUMENT: ErrorReason
ERROR_REASON_INVALID_INTERVAL: ErrorReason
ERROR_REASON_INVALID_NAME: ErrorReason
ERROR_REASON_MALFORMED_RUN: ErrorReason
ERROR_REASON_ITEM_TOO_LARGE: ErrorReason
ERROR_REASON_CHANNEL_NOT_FOUND: ErrorReason
ERROR_REASON_CHANNEL_EXISTS: ErrorReason
ERROR_REASON_HOST_NOT_FOUND: ErrorReason
ERROR_REASON_HOST_EXISTS: ErrorReason
ERROR_REASON_NO_HOST: ErrorReason
ERROR_REASON_WRONG_EPOCH: ErrorReason
ERROR_REASON_NOT_HERE: ErrorReason
ERROR_REASON_MOVED: ErrorReason
ERROR_REASON_TOO_OLD: ErrorReason
ERROR_REASON_IN_FUTURE: ErrorReason
ERROR_REASON_CHANNEL_FULL: ErrorReason
ERROR_REASON_OVERLOADED: ErrorReason
ERROR_REASON_INCARNATION_LOST: ErrorReason
ERROR_REASON_LEASE_EXPIRED: ErrorReason
ERROR_REASON_NOT_LEADER: ErrorReason
ERROR_REASON_NO_QUORUM: ErrorReason
ERROR_REASON_AMBIGUOUS: ErrorReason
ERROR_REASON_UNAUTHENTICATED: ErrorReason
ERROR_REASON_PERMISSION_DENIED: ErrorReason
ERROR_REASON_VERSION_MISMATCH: ErrorReason
ERROR_REASON_SHUTTING_DOWN: ErrorReason
ERROR_REASON_WATCH_RESTART: ErrorReason
ERROR_REASON_GROUP_NOT_FOUND: ErrorReason
ERROR_REASON_GROUP_EXISTS: ErrorReason
ERROR_REASON_QUEUE_NOT_FOUND: ErrorReason
ERROR_REASON_QUEUE_EXISTS: ErrorReason
ERROR_REASON_PEER_EXISTS: ErrorReason
ERROR_REASON_DEADLINE_EXCEEDED: ErrorReason
ERROR_REASON_INTERNAL: ErrorReason
ERROR_REASON_PEER_NOT_FOUND: ErrorReason
ERROR_REASON_QUEUE_FULL: ErrorReason
ERROR_REASON_MOVE_NOT_FOUND: ErrorReason
ERROR_REASON_MOVE_CONFLICT: ErrorReason
ERROR_REASON_WRONG_CLUSTER: ErrorReason
ERROR_REASON_STALE_REGISTRATION: ErrorReason
ERROR_REASON_CERTIFICATE_EXPIRED: ErrorReason
ERROR_REASON_TOKEN_EXPIRED: ErrorReason
ERROR_REASON_NOT_REPLICATED: ErrorReason
ERROR_REASON_NOT_ARCHIVED: ErrorReason
ERROR_REASON_AHEAD_OF_CLOCK: ErrorReason
ABSENCE_REASON_UNSPECIFIED: AbsenceReason
ABSENCE_REASON_COLLECTED: AbsenceReason
ABSENCE_REASON_NEVER: AbsenceReason
ABSENCE_REASON_NOT_YET: AbsenceReason
ABSENCE_REASON_HIDDEN: AbsenceReason
ABSENCE_REASON_LOST: AbsenceReason

class Error(_message.Message):
    __slots__ = ("reason", "message", "metadata")
    class MetadataEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    REASON_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    METADATA_FIELD_NUMBER: _ClassVar[int]
    reason: ErrorReason
    message: str
    metadata: _containers.ScalarMap[str, str]
    def __init__(self, reason: _Optional[_Union[ErrorReason, str]] = ..., message: _Optional[str] = ..., metadata: _Optional[_Mapping[str, str]] = ...) -> None: ...
