from stampede_rt.v1 import access_pb2 as _access_pb2
from stampede_rt.v1 import channel_pb2 as _channel_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class Transport(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRANSPORT_UNSPECIFIED: _ClassVar[Transport]
    TRANSPORT_GRPC: _ClassVar[Transport]
    TRANSPORT_SHARED_MEMORY: _ClassVar[Transport]
    TRANSPORT_SOCKET: _ClassVar[Transport]
TRANSPORT_UNSPECIFIED: Transport
TRANSPORT_GRPC: Transport
TRANSPORT_SHARED_MEMORY: Transport
TRANSPORT_SOCKET: Transport

class GatekeeperServicePingRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class GatekeeperServicePingResponse(_message.Message):
    __slots__ = ("time_unix_nano", "host_id", "name", "lease_held", "version", "refused_items", "refused_ago_nanos", "held_bytes", "memory_bytes_max", "refused_calls", "refused_call_ago_nanos", "access", "archive_failure", "archive_failing_channels", "archive_store_failure", "refused_for_archive")
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    LEASE_HELD_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    REFUSED_ITEMS_FIELD_NUMBER: _ClassVar[int]
    REFUSED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    HELD_BYTES_FIELD_NUMBER: _ClassVar[int]
    MEMORY_BYTES_MAX_FIELD_NUMBER: _ClassVar[int]
    REFUSED_CALLS_FIELD_NUMBER: _ClassVar[int]
    REFUSED_CALL_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    ACCESS_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_FAILURE_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_FAILING_CHANNELS_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_STORE_FAILURE_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FOR_ARCHIVE_FIELD_NUMBER: _ClassVar[int]
    time_unix_nano: int
    host_id: bytes
    name: str
    lease_held: bool
    version: str
    refused_items: int
    refused_ago_nanos: int
    held_bytes: int
    memory_bytes_max: int
    refused_calls: int
    refused_call_ago_nanos: int
    access: _access_pb2.AccessStatus
    archive_failure: str
    archive_failing_channels: int
    archive_store_failure: str
    refused_for_archive: bool
    def __init__(self, time_unix_nano: _Optional[int] = ..., host_id: _Optional[bytes] = ..., name: _Optional[str] = ..., lease_held: bool = ..., version: _Optional[str] = ..., refused_items: _Optional[int] = ..., refused_ago_nanos: _Optional[int] = ..., held_bytes: _Optional[int] = ..., memory_bytes_max: _Optional[int] = ..., refused_calls: _Optional[int] = ..., refused_call_ago_nanos: _Optional[int] = ..., access: _Optional[_Union[_access_pb2.AccessStatus, _Mapping]] = ..., archive_failure: _Optional[str] = ..., archive_failing_channels: _Optional[int] = ..., archive_store_failure: _Optional[str] = ..., refused_for_archive: bool = ...) -> None: ...

class DataEndpoint(_message.Message):
    __slots__ = ("transport", "target", "ticket")
    TRANSPORT_FIELD_NUMBER: _ClassVar[int]
    TARGET_FIELD_NUMBER: _ClassVar[int]
    TICKET_FIELD_NUMBER: _ClassVar[int]
    transport: Transport
    target: str
    ticket: bytes
    def __init__(self, transport: _Optional[_Union[Transport, str]] = ..., target: _Optional[str] = ..., ticket: _Optional[bytes] = ...) -> None: ...

class ListDataEndpointsRequest(_message.Message):
    __slots__ = ("machine",)
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    machine: str
    def __init__(self, machine: _Optional[str] = ...) -> None: ...

class ListDataEndpointsResponse(_message.Message):
    __slots__ = ("endpoints",)
    ENDPOINTS_FIELD_NUMBER: _ClassVar[int]
    endpoints: _containers.RepeatedCompositeFieldContainer[DataEndpoint]
    def __init__(self, endpoints: _Optional[_Iterable[_Union[DataEndpoint, _Mapping]]] = ...) -> None: ...

class BindChannelRequest(_message.Message):
    __slots__ = ("channel_id", "epoch", "spec_version", "machine", "wants_copy")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    WANTS_COPY_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    spec_version: int
    machine: str
    wants_copy: bool
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., spec_version: _Optional[int] = ..., machine: _Optional[str] = ..., wants_copy: bool = ...) -> None: ...

class BindChannelResponse(_message.Message):
    __slots__ = ("endpoints", "channel", "copy_target")
    ENDPOINTS_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    COPY_TARGET_FIELD_NUMBER: _ClassVar[int]
    endpoints: _containers.RepeatedCompositeFieldContainer[DataEndpoint]
    channel: _channel_pb2.ChannelRecord
    copy_target: str
    def __init__(self, endpoints: _Optional[_Iterable[_Union[DataEndpoint, _Mapping]]] = ..., channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., copy_target: _Optional[str] = ...) -> None: ...

class DropChannelRequest(_message.Message):
    __slots__ = ("request_id", "channel_id", "epoch")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    channel_id: bytes
    epoch: int
    def __init__(self, request_id: _Optional[bytes] = ..., channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class DropChannelResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ConfigureChannelRequest(_message.Message):
    __slots__ = ("request_id", "channel_id", "epoch", "spec")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    channel_id: bytes
    epoch: int
    spec: _channel_pb2.ChannelSpec
    def __init__(self, request_id: _Optional[bytes] = ..., channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., spec: _Optional[_Union[_channel_pb2.ChannelSpec, _Mapping]] = ...) -> None: ...

class ConfigureChannelResponse(_message.Message):
    __slots__ = ("channel",)
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ...) -> None: ...

class ListHostedChannelsRequest(_message.Message):
    __slots__ = ("name_glob", "page_size", "page_token")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    page_size: int
    page_token: str
    def __init__(self, name_glob: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListHostedChannelsResponse(_message.Message):
    __slots__ = ("channels", "next_page_token")
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelStatus]
    next_page_token: str
    def __init__(self, channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelStatus, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...
