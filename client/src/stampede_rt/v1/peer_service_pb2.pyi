from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import peer_pb2 as _peer_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RegisterPeerRequest(_message.Message):
    __slots__ = ("request_id", "peer_id", "name", "boot_incarnation", "proof", "mailbox", "mailbox_host_name", "host_id", "zone", "version", "attributes", "clock", "registration_epoch")
    class AttributesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PROOF_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_HOST_NAME_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    ZONE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_EPOCH_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    peer_id: bytes
    name: str
    boot_incarnation: int
    proof: bytes
    mailbox: _queue_pb2.QueueSpec
    mailbox_host_name: str
    host_id: bytes
    zone: str
    version: str
    attributes: _containers.ScalarMap[str, str]
    clock: _peer_pb2.ClockOffset
    registration_epoch: int
    def __init__(self, request_id: _Optional[bytes] = ..., peer_id: _Optional[bytes] = ..., name: _Optional[str] = ..., boot_incarnation: _Optional[int] = ..., proof: _Optional[bytes] = ..., mailbox: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ..., mailbox_host_name: _Optional[str] = ..., host_id: _Optional[bytes] = ..., zone: _Optional[str] = ..., version: _Optional[str] = ..., attributes: _Optional[_Mapping[str, str]] = ..., clock: _Optional[_Union[_peer_pb2.ClockOffset, _Mapping]] = ..., registration_epoch: _Optional[int] = ...) -> None: ...

class RegisterPeerResponse(_message.Message):
    __slots__ = ("peer", "lease_ttl_nanos", "mailbox", "mailbox_host", "mailbox_kept", "cluster_id")
    PEER_FIELD_NUMBER: _ClassVar[int]
    LEASE_TTL_NANOS_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_HOST_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_KEPT_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    peer: _peer_pb2.PeerRecord
    lease_ttl_nanos: int
    mailbox: _queue_pb2.QueueRecord
    mailbox_host: _directory_pb2.HostRecord
    mailbox_kept: bool
    cluster_id: str
    def __init__(self, peer: _Optional[_Union[_peer_pb2.PeerRecord, _Mapping]] = ..., lease_ttl_nanos: _Optional[int] = ..., mailbox: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., mailbox_host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., mailbox_kept: bool = ..., cluster_id: _Optional[str] = ...) -> None: ...

class RenewPeerLeaseRequest(_message.Message):
    __slots__ = ("peer_id", "boot_incarnation", "clock")
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CLOCK_FIELD_NUMBER: _ClassVar[int]
    peer_id: bytes
    boot_incarnation: int
    clock: _peer_pb2.ClockOffset
    def __init__(self, peer_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., clock: _Optional[_Union[_peer_pb2.ClockOffset, _Mapping]] = ...) -> None: ...

class RenewPeerLeaseResponse(_message.Message):
    __slots__ = ("lease_ttl_nanos", "tenure", "time_unix_nano", "supernode_id", "held_nanos")
    LEASE_TTL_NANOS_FIELD_NUMBER: _ClassVar[int]
    TENURE_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    HELD_NANOS_FIELD_NUMBER: _ClassVar[int]
    lease_ttl_nanos: int
    tenure: int
    time_unix_nano: int
    supernode_id: str
    held_nanos: int
    def __init__(self, lease_ttl_nanos: _Optional[int] = ..., tenure: _Optional[int] = ..., time_unix_nano: _Optional[int] = ..., supernode_id: _Optional[str] = ..., held_nanos: _Optional[int] = ...) -> None: ...

class DeregisterPeerRequest(_message.Message):
    __slots__ = ("request_id", "peer_id", "boot_incarnation")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    peer_id: bytes
    boot_incarnation: int
    def __init__(self, request_id: _Optional[bytes] = ..., peer_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ...) -> None: ...

class DeregisterPeerResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ResolvePeerRequest(_message.Message):
    __slots__ = ("peer_id", "name", "stale_ok", "with_clocks")
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    WITH_CLOCKS_FIELD_NUMBER: _ClassVar[int]
    peer_id: bytes
    name: str
    stale_ok: bool
    with_clocks: bool
    def __init__(self, peer_id: _Optional[bytes] = ..., name: _Optional[str] = ..., stale_ok: bool = ..., with_clocks: bool = ...) -> None: ...

class ResolvePeerResponse(_message.Message):
    __slots__ = ("peer", "applied_index")
    PEER_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    peer: _peer_pb2.PeerRecord
    applied_index: int
    def __init__(self, peer: _Optional[_Union[_peer_pb2.PeerRecord, _Mapping]] = ..., applied_index: _Optional[int] = ...) -> None: ...

class ListPeersRequest(_message.Message):
    __slots__ = ("name_glob", "page_size", "page_token", "stale_ok", "include_dead", "with_clocks")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_DEAD_FIELD_NUMBER: _ClassVar[int]
    WITH_CLOCKS_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    page_size: int
    page_token: str
    stale_ok: bool
    include_dead: bool
    with_clocks: bool
    def __init__(self, name_glob: _Optional[str] = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., stale_ok: bool = ..., include_dead: bool = ..., with_clocks: bool = ...) -> None: ...

class ListPeersResponse(_message.Message):
    __slots__ = ("peers", "next_page_token", "applied_index")
    PEERS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    peers: _containers.RepeatedCompositeFieldContainer[_peer_pb2.PeerRecord]
    next_page_token: str
    applied_index: int
    def __init__(self, peers: _Optional[_Iterable[_Union[_peer_pb2.PeerRecord, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., applied_index: _Optional[int] = ...) -> None: ...

class WatchPeersRequest(_message.Message):
    __slots__ = ("name_glob", "after_index")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    AFTER_INDEX_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    after_index: int
    def __init__(self, name_glob: _Optional[str] = ..., after_index: _Optional[int] = ...) -> None: ...

class WatchPeersResponse(_message.Message):
    __slots__ = ("changes", "applied_index")
    CHANGES_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    changes: _containers.RepeatedCompositeFieldContainer[_peer_pb2.PeerChange]
    applied_index: int
    def __init__(self, changes: _Optional[_Iterable[_Union[_peer_pb2.PeerChange, _Mapping]]] = ..., applied_index: _Optional[int] = ...) -> None: ...
