from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import group_pb2 as _group_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class OpenGroupRequest(_message.Message):
    __slots__ = ("request_id", "name", "spec", "create")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    CREATE_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    name: str
    spec: _group_pb2.GroupSpec
    create: bool
    def __init__(self, request_id: _Optional[bytes] = ..., name: _Optional[str] = ..., spec: _Optional[_Union[_group_pb2.GroupSpec, _Mapping]] = ..., create: bool = ...) -> None: ...

class OpenGroupResponse(_message.Message):
    __slots__ = ("group", "channels", "hosts", "created")
    GROUP_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    group: _group_pb2.GroupRecord
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    created: bool
    def __init__(self, group: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ..., channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., created: bool = ...) -> None: ...

class ResolveGroupRequest(_message.Message):
    __slots__ = ("group_id", "name", "stale_ok")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    name: str
    stale_ok: bool
    def __init__(self, group_id: _Optional[bytes] = ..., name: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ResolveGroupResponse(_message.Message):
    __slots__ = ("group", "channels", "hosts", "applied_index")
    GROUP_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    group: _group_pb2.GroupRecord
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    applied_index: int
    def __init__(self, group: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ..., channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., applied_index: _Optional[int] = ...) -> None: ...

class UpdateGroupRequest(_message.Message):
    __slots__ = ("request_id", "group_id", "add_channel_ids", "remove_channel_ids", "spec_version")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    ADD_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    REMOVE_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    group_id: bytes
    add_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    remove_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    spec_version: int
    def __init__(self, request_id: _Optional[bytes] = ..., group_id: _Optional[bytes] = ..., add_channel_ids: _Optional[_Iterable[bytes]] = ..., remove_channel_ids: _Optional[_Iterable[bytes]] = ..., spec_version: _Optional[int] = ...) -> None: ...

class UpdateGroupResponse(_message.Message):
    __slots__ = ("group",)
    GROUP_FIELD_NUMBER: _ClassVar[int]
    group: _group_pb2.GroupRecord
    def __init__(self, group: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ...) -> None: ...

class DeleteGroupRequest(_message.Message):
    __slots__ = ("request_id", "group_id")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    group_id: bytes
    def __init__(self, request_id: _Optional[bytes] = ..., group_id: _Optional[bytes] = ...) -> None: ...

class DeleteGroupResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListGroupsRequest(_message.Message):
    __slots__ = ("name_glob", "channel_id", "page_size", "page_token", "stale_ok")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    channel_id: bytes
    page_size: int
    page_token: str
    stale_ok: bool
    def __init__(self, name_glob: _Optional[str] = ..., channel_id: _Optional[bytes] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ListGroupsResponse(_message.Message):
    __slots__ = ("groups", "next_page_token", "applied_index")
    GROUPS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    groups: _containers.RepeatedCompositeFieldContainer[_group_pb2.GroupRecord]
    next_page_token: str
    applied_index: int
    def __init__(self, groups: _Optional[_Iterable[_Union[_group_pb2.GroupRecord, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., applied_index: _Optional[int] = ...) -> None: ...
