from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class AccessVerb(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ACCESS_VERB_UNSPECIFIED: _ClassVar[AccessVerb]
    ACCESS_VERB_READ: _ClassVar[AccessVerb]
    ACCESS_VERB_PUT: _ClassVar[AccessVerb]
    ACCESS_VERB_CONSUME: _ClassVar[AccessVerb]
    ACCESS_VERB_ADVANCE: _ClassVar[AccessVerb]
    ACCESS_VERB_CREATE: _ClassVar[AccessVerb]
    ACCESS_VERB_CONFIGURE: _ClassVar[AccessVerb]
    ACCESS_VERB_DELETE: _ClassVar[AccessVerb]
    ACCESS_VERB_TAKE: _ClassVar[AccessVerb]
    ACCESS_VERB_SEND: _ClassVar[AccessVerb]
    ACCESS_VERB_REGISTER: _ClassVar[AccessVerb]
    ACCESS_VERB_LIST: _ClassVar[AccessVerb]

class AccessKind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    ACCESS_KIND_UNSPECIFIED: _ClassVar[AccessKind]
    ACCESS_KIND_CHANNEL: _ClassVar[AccessKind]
    ACCESS_KIND_GROUP: _ClassVar[AccessKind]
    ACCESS_KIND_QUEUE: _ClassVar[AccessKind]
    ACCESS_KIND_PEER: _ClassVar[AccessKind]
ACCESS_VERB_UNSPECIFIED: AccessVerb
ACCESS_VERB_READ: AccessVerb
ACCESS_VERB_PUT: AccessVerb
ACCESS_VERB_CONSUME: AccessVerb
ACCESS_VERB_ADVANCE: AccessVerb
ACCESS_VERB_CREATE: AccessVerb
ACCESS_VERB_CONFIGURE: AccessVerb
ACCESS_VERB_DELETE: AccessVerb
ACCESS_VERB_TAKE: AccessVerb
ACCESS_VERB_SEND: AccessVerb
ACCESS_VERB_REGISTER: AccessVerb
ACCESS_VERB_LIST: AccessVerb
ACCESS_KIND_UNSPECIFIED: AccessKind
ACCESS_KIND_CHANNEL: AccessKind
ACCESS_KIND_GROUP: AccessKind
ACCESS_KIND_QUEUE: AccessKind
ACCESS_KIND_PEER: AccessKind

class AccessRule(_message.Message):
    __slots__ = ("who", "verbs", "kind", "names", "deny")
    WHO_FIELD_NUMBER: _ClassVar[int]
    VERBS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAMES_FIELD_NUMBER: _ClassVar[int]
    DENY_FIELD_NUMBER: _ClassVar[int]
    who: str
    verbs: _containers.RepeatedScalarFieldContainer[AccessVerb]
    kind: AccessKind
    names: str
    deny: bool
    def __init__(self, who: _Optional[str] = ..., verbs: _Optional[_Iterable[_Union[AccessVerb, str]]] = ..., kind: _Optional[_Union[AccessKind, str]] = ..., names: _Optional[str] = ..., deny: bool = ...) -> None: ...

class AccessStatus(_message.Message):
    __slots__ = ("version", "denials", "denied_ago_nanos", "quota_refusals", "quota_refused_ago_nanos", "limits_caller")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    DENIALS_FIELD_NUMBER: _ClassVar[int]
    DENIED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    QUOTA_REFUSALS_FIELD_NUMBER: _ClassVar[int]
    QUOTA_REFUSED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    LIMITS_CALLER_FIELD_NUMBER: _ClassVar[int]
    version: int
    denials: int
    denied_ago_nanos: int
    quota_refusals: int
    quota_refused_ago_nanos: int
    limits_caller: bool
    def __init__(self, version: _Optional[int] = ..., denials: _Optional[int] = ..., denied_ago_nanos: _Optional[int] = ..., quota_refusals: _Optional[int] = ..., quota_refused_ago_nanos: _Optional[int] = ..., limits_caller: bool = ...) -> None: ...
