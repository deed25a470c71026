from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class OpenQueueRequest(_message.Message):
    __slots__ = ("request_id", "name", "spec", "create", "host_name")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    CREATE_FIELD_NUMBER: _ClassVar[int]
    HOST_NAME_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    name: str
    spec: _queue_pb2.QueueSpec
    create: bool
    host_name: str
    def __init__(self, request_id: _Optional[bytes] = ..., name: _Optional[str] = ..., spec: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ..., create: bool = ..., host_name: _Optional[str] = ...) -> None: ...

class OpenQueueResponse(_message.Message):
    __slots__ = ("queue", "host", "created")
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    host: _directory_pb2.HostRecord
    created: bool
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., created: bool = ...) -> None: ...

class ResolveQueueRequest(_message.Message):
    __slots__ = ("queue_id", "name", "peer_name", "stale_ok")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    PEER_NAME_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    name: str
    peer_name: str
    stale_ok: bool
    def __init__(self, queue_id: _Optional[bytes] = ..., name: _Optional[str] = ..., peer_name: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ResolveQueueResponse(_message.Message):
    __slots__ = ("queue", "host", "applied_index")
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    host: _directory_pb2.HostRecord
    applied_index: int
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., host: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., applied_index: _Optional[int] = ...) -> None: ...

class UpdateQueueRequest(_message.Message):
    __slots__ = ("request_id", "queue_id", "epoch", "spec")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    queue_id: bytes
    epoch: int
    spec: _queue_pb2.QueueSpec
    def __init__(self, request_id: _Optional[bytes] = ..., queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., spec: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ...) -> None: ...

class UpdateQueueResponse(_message.Message):
    __slots__ = ("queue",)
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class DeleteQueueRequest(_message.Message):
    __slots__ = ("request_id", "queue_id")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    queue_id: bytes
    def __init__(self, request_id: _Optional[bytes] = ..., queue_id: _Optional[bytes] = ...) -> None: ...

class DeleteQueueResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListQueuesRequest(_message.Message):
    __slots__ = ("name_glob", "include_mailboxes", "page_size", "page_token", "stale_ok")
    NAME_GLOB_FIELD_NUMBER: _ClassVar[int]
    INCLUDE_MAILBOXES_FIELD_NUMBER: _ClassVar[int]
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    name_glob: str
    include_mailboxes: bool
    page_size: int
    page_token: str
    stale_ok: bool
    def __init__(self, name_glob: _Optional[str] = ..., include_mailboxes: bool = ..., page_size: _Optional[int] = ..., page_token: _Optional[str] = ..., stale_ok: bool = ...) -> None: ...

class ListQueuesResponse(_message.Message):
    __slots__ = ("queues", "hosts", "next_page_token", "applied_index")
    QUEUES_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    queues: _containers.RepeatedCompositeFieldContainer[_queue_pb2.QueueRecord]
    hosts: _containers.RepeatedCompositeFieldContainer[_directory_pb2.HostRecord]
    next_page_token: str
    applied_index: int
    def __init__(self, queues: _Optional[_Iterable[_Union[_queue_pb2.QueueRecord, _Mapping]]] = ..., hosts: _Optional[_Iterable[_Union[_directory_pb2.HostRecord, _Mapping]]] = ..., next_page_token: _Optional[str] = ..., applied_index: _Optional[int] = ...) -> None: ...
