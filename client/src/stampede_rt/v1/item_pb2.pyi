from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DeliveryEnd(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DELIVERY_END_UNSPECIFIED: _ClassVar[DeliveryEnd]
    DELIVERY_END_LEASE_EXPIRED: _ClassVar[DeliveryEnd]
    DELIVERY_END_GIVEN_BACK: _ClassVar[DeliveryEnd]
    DELIVERY_END_TERMINATED: _ClassVar[DeliveryEnd]
DELIVERY_END_UNSPECIFIED: DeliveryEnd
DELIVERY_END_LEASE_EXPIRED: DeliveryEnd
DELIVERY_END_GIVEN_BACK: DeliveryEnd
DELIVERY_END_TERMINATED: DeliveryEnd

class ItemRun(_message.Message):
    __slots__ = ("time_unix_nano", "duration_nanos", "payload_length_bytes", "content_type", "attributes", "payloads", "first_seq", "origin")
    class AttributesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    DURATION_NANOS_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_LENGTH_BYTES_FIELD_NUMBER: _ClassVar[int]
    CONTENT_TYPE_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    PAYLOADS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    time_unix_nano: _containers.RepeatedScalarFieldContainer[int]
    duration_nanos: _containers.RepeatedScalarFieldContainer[int]
    payload_length_bytes: _containers.RepeatedScalarFieldContainer[int]
    content_type: str
    attributes: _containers.ScalarMap[str, str]
    payloads: bytes
    first_seq: int
    origin: DeadLetterOrigin
    def __init__(self, time_unix_nano: _Optional[_Iterable[int]] = ..., duration_nanos: _Optional[_Iterable[int]] = ..., payload_length_bytes: _Optional[_Iterable[int]] = ..., content_type: _Optional[str] = ..., attributes: _Optional[_Mapping[str, str]] = ..., payloads: _Optional[bytes] = ..., first_seq: _Optional[int] = ..., origin: _Optional[_Union[DeadLetterOrigin, _Mapping]] = ...) -> None: ...

class DeadLetterOrigin(_message.Message):
    __slots__ = ("queue_id", "queue_name", "seq", "incarnation", "enqueued_unix_nano", "deliveries", "last_end", "reason", "last_taker_id", "last_taker_name")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    QUEUE_NAME_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    ENQUEUED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    DELIVERIES_FIELD_NUMBER: _ClassVar[int]
    LAST_END_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    LAST_TAKER_ID_FIELD_NUMBER: _ClassVar[int]
    LAST_TAKER_NAME_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    queue_name: str
    seq: int
    incarnation: int
    enqueued_unix_nano: int
    deliveries: int
    last_end: DeliveryEnd
    reason: str
    last_taker_id: int
    last_taker_name: str
    def __init__(self, queue_id: _Optional[bytes] = ..., queue_name: _Optional[str] = ..., seq: _Optional[int] = ..., incarnation: _Optional[int] = ..., enqueued_unix_nano: _Optional[int] = ..., deliveries: _Optional[int] = ..., last_end: _Optional[_Union[DeliveryEnd, str]] = ..., reason: _Optional[str] = ..., last_taker_id: _Optional[int] = ..., last_taker_name: _Optional[str] = ...) -> None: ...

class ItemPosition(_message.Message):
    __slots__ = ("time_unix_nano", "seq", "incarnation")
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    time_unix_nano: int
    seq: int
    incarnation: int
    def __init__(self, time_unix_nano: _Optional[int] = ..., seq: _Optional[int] = ..., incarnation: _Optional[int] = ...) -> None: ...

class DeliveredRun(_message.Message):
    __slots__ = ("run", "next_time_unix_nano")
    RUN_FIELD_NUMBER: _ClassVar[int]
    NEXT_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    run: ItemRun
    next_time_unix_nano: int
    def __init__(self, run: _Optional[_Union[ItemRun, _Mapping]] = ..., next_time_unix_nano: _Optional[int] = ...) -> None: ...
