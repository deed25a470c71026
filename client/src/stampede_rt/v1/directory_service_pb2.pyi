from stampede_rt.v1 import access_pb2 as _access_pb2
from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DirectoryServicePingRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class DirectoryServicePingResponse(_message.Message):
    __slots__ = ("time_unix_nano", "supernode_id", "ready", "cluster_id", "version", "refused_supernodes", "former_cluster_ids", "feature_level", "highest_feature_level", "boot_incarnation", "access")
    class RefusedSupernodesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    READY_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    REFUSED_SUPERNODES_FIELD_NUMBER: _ClassVar[int]
    FORMER_CLUSTER_IDS_FIELD_NUMBER: _ClassVar[int]
    FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    HIGHEST_FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    ACCESS_FIELD_NUMBER: _ClassVar[int]
    time_unix_nano: int
    supernode_id: str
    ready: bool
    cluster_id: str
    version: str
    refused_supernodes: _containers.ScalarMap[str, str]
    former_cluster_ids: _containers.RepeatedScalarFieldContainer[str]
    feature_level: int
    highest_feature_level: int
    boot_incarnation: int
    access: _access_pb2.AccessStatus
    def __init__(self, time_unix_nano: _Optional[int] = ..., supernode_id: _Optional[str] = ..., ready: bool = ..., cluster_id: _Optional[str] = ..., version: _Optional[str] = ..., refused_supernodes: _Optional[_Mapping[str, str]] = ..., former_cluster_ids: _Optional[_Iterable[str]] = ..., feature_level: _Optional[int] = ..., highest_feature_level: _Optional[int] = ..., boot_incarnation: _Optional[int] = ..., access: _Optional[_Union[_access_pb2.AccessStatus, _Mapping]] = ...) -> None: ...

class OpenChannelRequest(_message.Message):
    __slots__ = ("request_id", "name", "spec", "create", "host_name", "beside")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    CREATE_FIELD_NUMBER: _ClassVar[int]
    HOST_NAME_FIELD_NUMBER: _ClassVar[int]
    BESIDE_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    name: str
    spec: _channel_pb2.ChannelSpec
    create: bool
    host_name: str
    beside: str
    def __init__(self, request_id: _Optional[bytes] = ..., name: _Optional[str] = ..., spec: _Optional[_Union[_channel_pb2.ChannelSpec, _Mapping]] = ..., create: bool = ..., host_name: _Optional[str] = ..., beside: _Optional[str] = ...) -> None: ...

class OpenChannelResponse(_message.Message):
    __slots__ = ("channel", "host", "created")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    host: _directory_pb2.HostRecord
    created: bool
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., created: bool = ...) -> None: ...

class ResolveChannelRequest(_message.Message):
    __slots__ = ("channel_id", "name", "stale_ok")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    name: str
    stale_ok: bool
    def __init__(self, channel_id: _Optional[bytes] = ..., name: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ResolveChannelResponse(_message.Message):
    __slots__ = ("channel", "host", "applied_index")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    host: _directory_pb2.HostRecord
    applied_index: int
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., applied_index: _Optional[int] = ...) -> None: ...

class ListChannelsRequest(_message.Message):
    __slots__ = ("name_glob", "page_size", "page_token", "stale_ok")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    page_size: int
    page_token: str
    stale_ok: bool
    def __init__(self, name_glob: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ListChannelsResponse(_message.Message):
    __slots__ = ("channels", "hosts", "next_page_token", "applied_index")
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    next_page_token: str
    applied_index: int
    def __init__(self, channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., applied_index: _Optional[int] = ...) -> None: ...

class UpdateChannelRequest(_message.Message):
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

class UpdateChannelResponse(_message.Message):
    __slots__ = ("channel",)
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ...) -> None: ...

class DeleteChannelRequest(_message.Message):
    __slots__ = ("request_id", "channel_id")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    channel_id: bytes
    def __init__(self, request_id: _Optional[bytes] = ..., channel_id: _Optional[bytes] = ...) -> None: ...

class DeleteChannelResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class RegisterHostRequest(_message.Message):
    __slots__ = ("request_id", "host_id", "name", "gatekeepers", "boot_incarnation", "version", "protocol_version", "registration_epoch", "has_archive", "continues_boot_incarnation", "move_key", "private", "machine", "archive_wait_nanos", "archive_place")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    GATEKEEPERS_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_EPOCH_FIELD_NUMBER: _ClassVar[int]
    HAS_ARCHIVE_FIELD_NUMBER: _ClassVar[int]
    CONTINUES_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    MOVE_KEY_FIELD_NUMBER: _ClassVar[int]
    PRIVATE_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_PLACE_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    host_id: bytes
    name: str
    gatekeepers: _containers.RepeatedCompositeFieldContainer[_directory_pb2.Endpoint]
    boot_incarnation: int
    version: str
    protocol_version: int
    registration_epoch: int
    has_archive: bool
    continues_boot_incarnation: int
    move_key: bytes
    private: bool
    machine: str
    archive_wait_nanos: int
    archive_place: str
    def __init__(self, request_id: _Optional[bytes] = ..., host_id: _Optional[bytes] = ..., name: _Optional[str] = ..., gatekeepers: _Optional[_Iterable[_Union[_directory_pb2.Endpoint, _Mapping]]] = ..., boot_incarnation: _Optional[int] = ..., version: _Optional[str] = ..., protocol_version: _Optional[int] = ..., registration_epoch: _Optional[int] = ..., has_archive: bool = ..., continues_boot_incarnation: _Optional[int] = ..., move_key: _Optional[bytes] = ..., private: bool = ..., machine: _Optional[str] = ..., archive_wait_nanos: _Optional[int] = ..., archive_place: _Optional[str] = ...) -> None: ...

class RegisterHostResponse(_message.Message):
    __slots__ = ("host", "lease_ttl_nanos", "channels", "cluster_id", "protocol_version", "queues", "former_cluster_ids", "registered_index")
    HOST_FIELD_NUMBER: _ClassVar[int]
    LEASE_TTL_NANOS_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    QUEUES_FIELD_NUMBER: _ClassVar[int]
    FORMER_CLUSTER_IDS_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    host: _directory_pb2.HostRecord
    lease_ttl_nanos: int
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    cluster_id: str
    protocol_version: int
    queues: _containers.RepeatedCompositeFieldContainer[_queue_pb2.QueueRecord]
    former_cluster_ids: _containers.RepeatedScalarFieldContainer[str]
    registered_index: int
    def __init__(self, host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., lease_ttl_nanos: _Optional[int] = ..., channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ..., cluster_id: _Optional[str] = ..., protocol_version: _Optional[int] = ..., queues: _Optional[_Iterable[_Union[_queue_pb2.QueueRecord, _Mapping]]] = ..., former_cluster_ids: _Optional[_Iterable[str]] = ..., registered_index: _Optional[int] = ...) -> None: ...

class RenewHostLeaseRequest(_message.Message):
    __slots__ = ("host_id", "boot_incarnation", "load", "registered_index")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    LOAD_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    boot_incarnation: int
    load: _directory_pb2.HostLoad
    registered_index: int
    def __init__(self, host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., load: _Optional[_Union[_directory_pb2.HostLoad, _Mapping]] = ..., registered_index: _Optional[int] = ...) -> None: ...

class RenewHostLeaseResponse(_message.Message):
    __slots__ = ("lease_ttl_nanos", "tenure", "cluster_id", "former_cluster_ids", "time_unix_nano")
    LEASE_TTL_NANOS_FIELD_NUMBER: _ClassVar[int]
    TENURE_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    FORMER_CLUSTER_IDS_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    lease_ttl_nanos: int
    tenure: int
    cluster_id: str
    former_cluster_ids: _containers.RepeatedScalarFieldContainer[str]
    time_unix_nano: int
    def __init__(self, lease_ttl_nanos: _Optional[int] = ..., tenure: _Optional[int] = ..., cluster_id: _Optional[str] = ..., former_cluster_ids: _Optional[_Iterable[str]] = ..., time_unix_nano: _Optional[int] = ...) -> None: ...

class DeregisterHostRequest(_message.Message):
    __slots__ = ("request_id", "host_id", "boot_incarnation")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    host_id: bytes
    boot_incarnation: int
    def __init__(self, request_id: _Optional[bytes] = ..., host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ...) -> None: ...

class DeregisterHostResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ResolveHostRequest(_message.Message):
    __slots__ = ("host_id", "name", "stale_ok")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    name: str
    stale_ok: bool
    def __init__(self, host_id: _Optional[bytes] = ..., name: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ResolveHostResponse(_message.Message):
    __slots__ = ("host", "applied_index")
    HOST_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    host: _directory_pb2.HostRecord
    applied_index: int
    def __init__(self, host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., applied_index: _Optional[int] = ...) -> None: ...

class ListHostsRequest(_message.Message):
    __slots__ = ("page_size", "page_token", "include_dead", "stale_ok")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_DEAD_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    include_dead: bool
    stale_ok: bool
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., include_dead: bool = ..., stale_ok: bool = ...) -> None: ...

class ListHostsResponse(_message.Message):
    __slots__ = ("hosts", "next_page_token", "applied_index")
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    next_page_token: str
    applied_index: int
    def __init__(self, hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., applied_index: _Optional[int] = ...) -> None: ...

class ListSupernodesRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListSupernodesResponse(_message.Message):
    __slots__ = ("supernodes", "term", "applied_index", "feature_level")
    SUPERNODES_FIELD_NUMBER: _ClassVar[int]
    TERM_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    supernodes: _containers.RepeatedCompositeFieldContainer[_directory_pb2.SupernodeRecord]
    term: int
    applied_index: int
    feature_level: int
    def __init__(self, supernodes: _Optional[_Iterable[_Union[_directory_pb2.SupernodeRecord, _Mapping]]] = ..., term: _Optional[int] = ..., applied_index: _Optional[int] = ..., feature_level: _Optional[int] = ...) -> None: ...

class WatchRequest(_message.Message):
    __slots__ = ("name_glob", "after_index", "include_hosts", "include_groups", "include_queues", "include_access")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    AFTER_INDEX_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_HOSTS_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_GROUPS_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_QUEUES_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_ACCESS_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    after_index: int
    include_hosts: bool
    include_groups: bool
    include_queues: bool
    include_access: bool
    def __init__(self, name_glob: _Optional[str] = ..., after_index: _Optional[int] = ..., include_hosts: bool = ..., include_groups: bool = ..., include_queues: bool = ..., include_access: bool = ...) -> None: ...

class WatchResponse(_message.Message):
    __slots__ = ("changes", "applied_index")
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    changes: _containers.RepeatedCompositeFieldContainer[_directory_pb2.DirectoryChange]
    applied_index: int
    def __init__(self, changes: _Optional[_Iterable[_Union[_directory_pb2.DirectoryChange, _Mapping]]] = ..., applied_index: _Optional[int] = ...) -> None: ...
