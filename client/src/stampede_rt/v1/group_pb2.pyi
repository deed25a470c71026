from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class GroupReference(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    GROUP_REFERENCE_UNSPECIFIED: _ClassVar[GroupReference]
    GROUP_REFERENCE_OLDEST: _ClassVar[GroupReference]
    GROUP_REFERENCE_CHANNEL: _ClassVar[GroupReference]

class GroupBound(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    GROUP_BOUND_UNSPECIFIED: _ClassVar[GroupBound]
    GROUP_BOUND_START: _ClassVar[GroupBound]
    GROUP_BOUND_END: _ClassVar[GroupBound]
GROUP_REFERENCE_UNSPECIFIED: GroupReference
GROUP_REFERENCE_OLDEST: GroupReference
GROUP_REFERENCE_CHANNEL: GroupReference
GROUP_BOUND_UNSPECIFIED: GroupBound
GROUP_BOUND_START: GroupBound
GROUP_BOUND_END: GroupBound

class GroupSpec(_message.Message):
    __slots__ = ("channel_ids", "reference", "reference_channel_id", "bound", "idle_after_nanos", "max_lead_nanos")
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    BOUND_FIELD_NUMBER: _ClassVar[int]
    IDLE_AFTER_NANOS_FIELD_NUMBER: _ClassVar[int]
    MAX_LEAD_NANOS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    reference: GroupReference
    reference_channel_id: bytes
    bound: GroupBound
    idle_after_nanos: int
    max_lead_nanos: int
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ..., reference: _Optional[_Union[GroupReference, str]] = ..., reference_channel_id: _Optional[bytes] = ..., bound: _Optional[_Union[GroupBound, str]] = ..., idle_after_nanos: _Optional[int] = ..., max_lead_nanos: _Optional[int] = ...) -> None: ...

class GroupRecord(_message.Message):
    __slots__ = ("group_id", "name", "spec", "spec_version", "incarnation", "created_by")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    name: str
    spec: GroupSpec
    spec_version: int
    incarnation: int
    created_by: str
    def __init__(self, group_id: _Optional[bytes] = ..., name: _Optional[str] = ..., spec: _Optional[_Union[GroupSpec, _Mapping]] = ..., spec_version: _Optional[int] = ..., incarnation: _Optional[int] = ..., created_by: _Optional[str] = ...) -> None: ...

class ChannelTimes(_message.Message):
    __slots__ = ("channel_id", "epoch", "incarnation", "newest_unix_nano", "newest_end_unix_nano", "advance_unix_nano", "silent_nanos")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NEWEST_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    NEWEST_END_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SILENT_NANOS_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    incarnation: int
    newest_unix_nano: int
    newest_end_unix_nano: int
    advance_unix_nano: int
    silent_nanos: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., incarnation: _Optional[int] = ..., newest_unix_nano: _Optional[int] = ..., newest_end_unix_nano: _Optional[int] = ..., advance_unix_nano: _Optional[int] = ..., silent_nanos: _Optional[int] = ...) -> None: ...

class CutFloor(_message.Message):
    __slots__ = ("group_id", "incarnation", "cut_unix_nano", "spec_version")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    incarnation: int
    cut_unix_nano: int
    spec_version: int
    def __init__(self, group_id: _Optional[bytes] = ..., incarnation: _Optional[int] = ..., cut_unix_nano: _Optional[int] = ..., spec_version: _Optional[int] = ...) -> None: ...

class GroupMemberStatus(_message.Message):
    __slots__ = ("times", "cut_unix_nano", "lead_nanos", "hidden_items", "idle", "window_too_short", "heard_ago_nanos")
    TIMES_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    LEAD_NANOS_FIELD_NUMBER: _ClassVar[int]
    HIDDEN_ITEMS_FIELD_NUMBER: _ClassVar[int]
    IDLE_FIELD_NUMBER: _ClassVar[int]
    WINDOW_TOO_SHORT_FIELD_NUMBER: _ClassVar[int]
    HEARD_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    times: ChannelTimes
    cut_unix_nano: int
    lead_nanos: int
    hidden_items: int
    idle: bool
    window_too_short: bool
    heard_ago_nanos: int
    def __init__(self, times: _Optional[_Union[ChannelTimes, _Mapping]] = ..., cut_unix_nano: _Optional[int] = ..., lead_nanos: _Optional[int] = ..., hidden_items: _Optional[int] = ..., idle: bool = ..., window_too_short: bool = ..., heard_ago_nanos: _Optional[int] = ...) -> None: ...

class GroupStatus(_message.Message):
    __slots__ = ("record", "cut_unix_nano", "waiting_on_channel_ids", "members", "host_time_unix_nano")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    WAITING_ON_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    MEMBERS_FIELD_NUMBER: _ClassVar[int]
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    record: GroupRecord
    cut_unix_nano: int
    waiting_on_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    members: _containers.RepeatedCompositeFieldContainer[GroupMemberStatus]
    host_time_unix_nano: int
    def __init__(self, record: _Optional[_Union[GroupRecord, _Mapping]] = ..., cut_unix_nano: _Optional[int] = ..., waiting_on_channel_ids: _Optional[_Iterable[bytes]] = ..., members: _Optional[_Iterable[_Union[GroupMemberStatus, _Mapping]]] = ..., host_time_unix_nano: _Optional[int] = ...) -> None: ...
