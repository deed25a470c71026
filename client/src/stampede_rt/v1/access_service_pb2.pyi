from stampede_rt.v1 import access_pb2 as _access_pb2
from stampede_rt.v1 import quota_pb2 as _quota_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CreateClientTokenRequest(_message.Message):
    __slots__ = ("request_id", "name", "roles", "valid_nanos")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ROLES_FIELD_NUMBER: _ClassVar[int]
    VALID_NANOS_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    name: str
    roles: _containers.RepeatedScalarFieldContainer[str]
    valid_nanos: int
    def __init__(self, request_id: _Optional[bytes] = ..., name: _Optional[str] = ..., roles: _Optional[_Iterable[str]] = ..., valid_nanos: _Optional[int] = ...) -> None: ...

class CreateClientTokenResponse(_message.Message):
    __slots__ = ("token", "serial", "valid_until_unix_nano", "version")
    TOKEN_FIELD_NUMBER: _ClassVar[int]
    SERIAL_FIELD_NUMBER: _ClassVar[int]
    VALID_UNTIL_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    token: str
    serial: str
    valid_until_unix_nano: int
    version: int
    def __init__(self, token: _Optional[str] = ..., serial: _Optional[str] = ..., valid_until_unix_nano: _Optional[int] = ..., version: _Optional[int] = ...) -> None: ...

class GetAccessStateRequest(_message.Message):
    __slots__ = ("stale_ok",)
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    stale_ok: bool
    def __init__(self, stale_ok: bool = ...) -> None: ...

class GetAccessStateResponse(_message.Message):
    __slots__ = ("version", "cluster_id", "rules", "token_keys", "revoked_serials", "quotas")
    VERSION_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    RULES_FIELD_NUMBER: _ClassVar[int]
    TOKEN_KEYS_FIELD_NUMBER: _ClassVar[int]
    REVOKED_SERIALS_FIELD_NUMBER: _ClassVar[int]
    QUOTAS_FIELD_NUMBER: _ClassVar[int]
    version: int
    cluster_id: str
    rules: _containers.RepeatedCompositeFieldContainer[_access_pb2.AccessRule]
    token_keys: _containers.RepeatedScalarFieldContainer[bytes]
    revoked_serials: _containers.RepeatedScalarFieldContainer[str]
    quotas: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaSetting]
    def __init__(self, version: _Optional[int] = ..., cluster_id: _Optional[str] = ..., rules: _Optional[_Iterable[_Union[_access_pb2.AccessRule, _Mapping]]] = ..., token_keys: _Optional[_Iterable[bytes]] = ..., revoked_serials: _Optional[_Iterable[str]] = ..., quotas: _Optional[_Iterable[_Union[_quota_pb2.QuotaSetting, _Mapping]]] = ...) -> None: ...

class AddAccessRuleRequest(_message.Message):
    __slots__ = ("request_id", "rule", "dry_run")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    RULE_FIELD_NUMBER: _ClassVar[int]
    DRY_RUN_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    rule: _access_pb2.AccessRule
    dry_run: bool
    def __init__(self, request_id: _Optional[bytes] = ..., rule: _Optional[_Union[_access_pb2.AccessRule, _Mapping]] = ..., dry_run: bool = ...) -> None: ...

class AddAccessRuleResponse(_message.Message):
    __slots__ = ("added", "rules", "effects", "version")
    ADDED_FIELD_NUMBER: _ClassVar[int]
    RULES_FIELD_NUMBER: _ClassVar[int]
    EFFECTS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    added: bool
    rules: int
    effects: _containers.RepeatedCompositeFieldContainer[AccessEffect]
    version: int
    def __init__(self, added: bool = ..., rules: _Optional[int] = ..., effects: _Optional[_Iterable[_Union[AccessEffect, _Mapping]]] = ..., version: _Optional[int] = ...) -> None: ...

class RemoveAccessRuleRequest(_message.Message):
    __slots__ = ("request_id", "rule", "dry_run")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    RULE_FIELD_NUMBER: _ClassVar[int]
    DRY_RUN_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    rule: _access_pb2.AccessRule
    dry_run: bool
    def __init__(self, request_id: _Optional[bytes] = ..., rule: _Optional[_Union[_access_pb2.AccessRule, _Mapping]] = ..., dry_run: bool = ...) -> None: ...

class RemoveAccessRuleResponse(_message.Message):
    __slots__ = ("removed", "rules", "effects", "version")
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    RULES_FIELD_NUMBER: _ClassVar[int]
    EFFECTS_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    removed: bool
    rules: int
    effects: _containers.RepeatedCompositeFieldContainer[AccessEffect]
    version: int
    def __init__(self, removed: bool = ..., rules: _Optional[int] = ..., effects: _Optional[_Iterable[_Union[AccessEffect, _Mapping]]] = ..., version: _Optional[int] = ...) -> None: ...

class AccessEffect(_message.Message):
    __slots__ = ("verb", "kind", "name", "allowed")
    VERB_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    ALLOWED_FIELD_NUMBER: _ClassVar[int]
    verb: _access_pb2.AccessVerb
    kind: _access_pb2.AccessKind
    name: str
    allowed: bool
    def __init__(self, verb: _Optional[_Union[_access_pb2.AccessVerb, str]] = ..., kind: _Optional[_Union[_access_pb2.AccessKind, str]] = ..., name: _Optional[str] = ..., allowed: bool = ...) -> None: ...

class ListAccessRulesRequest(_message.Message):
    __slots__ = ("stale_ok",)
    STALE_OK_FIELD_NUMBER: _ClassVar[int]
    stale_ok: bool
    def __init__(self, stale_ok: bool = ...) -> None: ...

class ListAccessRulesResponse(_message.Message):
    __slots__ = ("rules", "version")
    RULES_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    rules: _containers.RepeatedCompositeFieldContainer[_access_pb2.AccessRule]
    version: int
    def __init__(self, rules: _Optional[_Iterable[_Union[_access_pb2.AccessRule, _Mapping]]] = ..., version: _Optional[int] = ...) -> None: ...

class CheckAccessRequest(_message.Message):
    __slots__ = ("who", "verb", "kind", "name")
    WHO_FIELD_NUMBER: _ClassVar[int]
    VERB_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    who: str
    verb: _access_pb2.AccessVerb
    kind: _access_pb2.AccessKind
    name: str
    def __init__(self, who: _Optional[str] = ..., verb: _Optional[_Union[_access_pb2.AccessVerb, str]] = ..., kind: _Optional[_Union[_access_pb2.AccessKind, str]] = ..., name: _Optional[str] = ...) -> None: ...

class CheckAccessResponse(_message.Message):
    __slots__ = ("allowed", "rule", "rules")
    ALLOWED_FIELD_NUMBER: _ClassVar[int]
    RULE_FIELD_NUMBER: _ClassVar[int]
    RULES_FIELD_NUMBER: _ClassVar[int]
    allowed: bool
    rule: _access_pb2.AccessRule
    rules: int
    def __init__(self, allowed: bool = ..., rule: _Optional[_Union[_access_pb2.AccessRule, _Mapping]] = ..., rules: _Optional[int] = ...) -> None: ...

class RevokeCredentialRequest(_message.Message):
    __slots__ = ("request_id", "serial")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    SERIAL_FIELD_NUMBER: _ClassVar[int]
    request_id: bytes
    serial: str
    def __init__(self, request_id: _Optional[bytes] = ..., serial: _Optional[str] = ...) -> None: ...

class RevokeCredentialResponse(_message.Message):
    __slots__ = ("revoked", "version")
    REVOKED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    revoked: bool
    version: int
    def __init__(self, revoked: bool = ..., version: _Optional[int] = ...) -> None: ...

class ListRevokedCredentialsRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ListRevokedCredentialsResponse(_message.Message):
    __slots__ = ("serials",)
    SERIALS_FIELD_NUMBER: _ClassVar[int]
    serials: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, serials: _Optional[_Iterable[str]] = ...) -> None: ...
