from stampede_rt.v1 import access_pb2 as _access_pb2
from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import directory_pb2 as _directory_pb2
from stampede_rt.v1 import group_pb2 as _group_pb2
from stampede_rt.v1 import move_pb2 as _move_pb2
from stampede_rt.v1 import peer_pb2 as _peer_pb2
from stampede_rt.v1 import queue_pb2 as _queue_pb2
from stampede_rt.v1 import quota_pb2 as _quota_pb2
from stampede_rt.v1 import replica_pb2 as _replica_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DirectoryCommand(_message.Message):
    __slots__ = ("op_id", "time_unix_nano", "open_channel", "update_channel", "delete_channel", "register_host", "deregister_host", "expire_host", "begin_tenure", "open_group", "update_group", "delete_group", "add_replica", "remove_replica", "set_replica_in_sync", "open_queue", "update_queue", "delete_queue", "register_peer", "deregister_peer", "expire_peers", "mark_time", "raise_feature_level", "create_token_key", "add_access_rule", "remove_access_rule", "revoke_credential", "set_quotas", "remove_quotas", "note_host_loads", "commit_move", "commit_queue_move", "commit_moves", "release_moves", "as_of_index", "caller")
    OP_ID_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    OPEN_CHANNEL_FIELD_NUMBER: _ClassVar[int]
    UPDATE_CHANNEL_FIELD_NUMBER: _ClassVar[int]
    DELETE_CHANNEL_FIELD_NUMBER: _ClassVar[int]
    REGISTER_HOST_FIELD_NUMBER: _ClassVar[int]
    DEREGISTER_HOST_FIELD_NUMBER: _ClassVar[int]
    EXPIRE_HOST_FIELD_NUMBER: _ClassVar[int]
    BEGIN_TENURE_FIELD_NUMBER: _ClassVar[int]
    OPEN_GROUP_FIELD_NUMBER: _ClassVar[int]
    UPDATE_GROUP_FIELD_NUMBER: _ClassVar[int]
    DELETE_GROUP_FIELD_NUMBER: _ClassVar[int]
    ADD_REPLICA_FIELD_NUMBER: _ClassVar[int]
    REMOVE_REPLICA_FIELD_NUMBER: _ClassVar[int]
    SET_REPLICA_IN_SYNC_FIELD_NUMBER: _ClassVar[int]
    OPEN_QUEUE_FIELD_NUMBER: _ClassVar[int]
    UPDATE_QUEUE_FIELD_NUMBER: _ClassVar[int]
    DELETE_QUEUE_FIELD_NUMBER: _ClassVar[int]
    REGISTER_PEER_FIELD_NUMBER: _ClassVar[int]
    DEREGISTER_PEER_FIELD_NUMBER: _ClassVar[int]
    EXPIRE_PEERS_FIELD_NUMBER: _ClassVar[int]
    MARK_TIME_FIELD_NUMBER: _ClassVar[int]
    RAISE_FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    CREATE_TOKEN_KEY_FIELD_NUMBER: _ClassVar[int]
    ADD_ACCESS_RULE_FIELD_NUMBER: _ClassVar[int]
    REMOVE_ACCESS_RULE_FIELD_NUMBER: _ClassVar[int]
    REVOKE_CREDENTIAL_FIELD_NUMBER: _ClassVar[int]
    SET_QUOTAS_FIELD_NUMBER: _ClassVar[int]
    REMOVE_QUOTAS_FIELD_NUMBER: _ClassVar[int]
    NOTE_HOST_LOADS_FIELD_NUMBER: _ClassVar[int]
    COMMIT_MOVE_FIELD_NUMBER: _ClassVar[int]
    COMMIT_QUEUE_MOVE_FIELD_NUMBER: _ClassVar[int]
    COMMIT_MOVES_FIELD_NUMBER: _ClassVar[int]
    RELEASE_MOVES_FIELD_NUMBER: _ClassVar[int]
    AS_OF_INDEX_FIELD_NUMBER: _ClassVar[int]
    CALLER_FIELD_NUMBER: _ClassVar[int]
    op_id: bytes
    time_unix_nano: int
    open_channel: OpenChannelCommand
    update_channel: UpdateChannelCommand
    delete_channel: DeleteChannelCommand
    register_host: RegisterHostCommand
    deregister_host: DeregisterHostCommand
    expire_host: ExpireHostCommand
    begin_tenure: BeginTenureCommand
    open_group: OpenGroupCommand
    update_group: UpdateGroupCommand
    delete_group: DeleteGroupCommand
    add_replica: AddReplicaCommand
    remove_replica: RemoveReplicaCommand
    set_replica_in_sync: SetReplicaInSyncCommand
    open_queue: OpenQueueCommand
    update_queue: UpdateQueueCommand
    delete_queue: DeleteQueueCommand
    register_peer: RegisterPeerCommand
    deregister_peer: DeregisterPeerCommand
    expire_peers: ExpirePeersCommand
    mark_time: MarkTimeCommand
    raise_feature_level: RaiseFeatureLevelCommand
    create_token_key: CreateTokenKeyCommand
    add_access_rule: AddAccessRuleCommand
    remove_access_rule: RemoveAccessRuleCommand
    revoke_credential: RevokeCredentialCommand
    set_quotas: SetQuotasCommand
    remove_quotas: RemoveQuotasCommand
    note_host_loads: NoteHostLoadsCommand
    commit_move: CommitMoveCommand
    commit_queue_move: CommitQueueMoveCommand
    commit_moves: CommitMovesCommand
    release_moves: ReleaseMovesCommand
    as_of_index: int
    caller: str
    def __init__(self, op_id: _Optional[bytes] = ..., time_unix_nano: _Optional[int] = ..., open_channel: _Optional[_Union[OpenChannelCommand, _Mapping]] = ..., update_channel: _Optional[_Union[UpdateChannelCommand, _Mapping]] = ..., delete_channel: _Optional[_Union[DeleteChannelCommand, _Mapping]] = ..., register_host: _Optional[_Union[RegisterHostCommand, _Mapping]] = ..., deregister_host: _Optional[_Union[DeregisterHostCommand, _Mapping]] = ..., expire_host: _Optional[_Union[ExpireHostCommand, _Mapping]] = ..., begin_tenure: _Optional[_Union[BeginTenureCommand, _Mapping]] = ..., open_group: _Optional[_Union[OpenGroupCommand, _Mapping]] = ..., update_group: _Optional[_Union[UpdateGroupCommand, _Mapping]] = ..., delete_group: _Optional[_Union[DeleteGroupCommand, _Mapping]] = ..., add_replica: _Optional[_Union[AddReplicaCommand, _Mapping]] = ..., remove_replica: _Optional[_Union[RemoveReplicaCommand, _Mapping]] = ..., set_replica_in_sync: _Optional[_Union[SetReplicaInSyncCommand, _Mapping]] = ..., open_queue: _Optional[_Union[OpenQueueCommand, _Mapping]] = ..., update_queue: _Optional[_Union[UpdateQueueCommand, _Mapping]] = ..., delete_queue: _Optional[_Union[DeleteQueueCommand, _Mapping]] = ..., register_peer: _Optional[_Union[RegisterPeerCommand, _Mapping]] = ..., deregister_peer: _Optional[_Union[DeregisterPeerCommand, _Mapping]] = ..., expire_peers: _Optional[_Union[ExpirePeersCommand, _Mapping]] = ..., mark_time: _Optional[_Union[MarkTimeCommand, _Mapping]] = ..., raise_feature_level: _Optional[_Union[RaiseFeatureLevelCommand, _Mapping]] = ..., create_token_key: _Optional[_Union[CreateTokenKeyCommand, _Mapping]] = ..., add_access_rule: _Optional[_Union[AddAccessRuleCommand, _Mapping]] = ..., remove_access_rule: _Optional[_Union[RemoveAccessRuleCommand, _Mapping]] = ..., revoke_credential: _Optional[_Union[RevokeCredentialCommand, _Mapping]] = ..., set_quotas: _Optional[_Union[SetQuotasCommand, _Mapping]] = ..., remove_quotas: _Optional[_Union[RemoveQuotasCommand, _Mapping]] = ..., note_host_loads: _Optional[_Union[NoteHostLoadsCommand, _Mapping]] = ..., commit_move: _Optional[_Union[CommitMoveCommand, _Mapping]] = ..., commit_queue_move: _Optional[_Union[CommitQueueMoveCommand, _Mapping]] = ..., commit_moves: _Optional[_Union[CommitMovesCommand, _Mapping]] = ..., release_moves: _Optional[_Union[ReleaseMovesCommand, _Mapping]] = ..., as_of_index: _Optional[int] = ..., caller: _Optional[str] = ...) -> None: ...

class RaiseFeatureLevelCommand(_message.Message):
    __slots__ = ("feature_level", "tenure")
    FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    TENURE_FIELD_NUMBER: _ClassVar[int]
    feature_level: int
    tenure: int
    def __init__(self, feature_level: _Optional[int] = ..., tenure: _Optional[int] = ...) -> None: ...

class CreateTokenKeyCommand(_message.Message):
    __slots__ = ("new_token_key",)
    NEW_TOKEN_KEY_FIELD_NUMBER: _ClassVar[int]
    new_token_key: bytes
    def __init__(self, new_token_key: _Optional[bytes] = ...) -> None: ...

class AddAccessRuleCommand(_message.Message):
    __slots__ = ("rule",)
    RULE_FIELD_NUMBER: _ClassVar[int]
    rule: _access_pb2.AccessRule
    def __init__(self, rule: _Optional[_Union[_access_pb2.AccessRule, _Mapping]] = ...) -> None: ...

class RemoveAccessRuleCommand(_message.Message):
    __slots__ = ("rule",)
    RULE_FIELD_NUMBER: _ClassVar[int]
    rule: _access_pb2.AccessRule
    def __init__(self, rule: _Optional[_Union[_access_pb2.AccessRule, _Mapping]] = ...) -> None: ...

class SetQuotasCommand(_message.Message):
    __slots__ = ("settings",)
    SETTINGS_FIELD_NUMBER: _ClassVar[int]
    settings: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaSetting]
    def __init__(self, settings: _Optional[_Iterable[_Union[_quota_pb2.QuotaSetting, _Mapping]]] = ...) -> None: ...

class RemoveQuotasCommand(_message.Message):
    __slots__ = ("who", "kinds")
    WHO_FIELD_NUMBER: _ClassVar[int]
    KINDS_FIELD_NUMBER: _ClassVar[int]
    who: str
    kinds: _containers.RepeatedScalarFieldContainer[_quota_pb2.QuotaKind]
    def __init__(self, who: _Optional[str] = ..., kinds: _Optional[_Iterable[_Union[_quota_pb2.QuotaKind, str]]] = ...) -> None: ...

class RevokeCredentialCommand(_message.Message):
    __slots__ = ("serial",)
    SERIAL_FIELD_NUMBER: _ClassVar[int]
    serial: str
    def __init__(self, serial: _Optional[str] = ...) -> None: ...

class MarkTimeCommand(_message.Message):
    __slots__ = ("tenure", "after_index")
    TENURE_FIELD_NUMBER: _ClassVar[int]
    AFTER_INDEX_FIELD_NUMBER: _ClassVar[int]
    tenure: int
    after_index: int
    def __init__(self, tenure: _Optional[int] = ..., after_index: _Optional[int] = ...) -> None: ...

class OpenChannelCommand(_message.Message):
    __slots__ = ("name", "spec", "create", "host_name", "new_channel_id", "new_incarnation", "created_by", "created_max", "beside", "waited_for_index")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    CREATE_FIELD_NUMBER: _ClassVar[int]
    HOST_NAME_FIELD_NUMBER: _ClassVar[int]
    NEW_CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    NEW_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    CREATED_MAX_FIELD_NUMBER: _ClassVar[int]
    BESIDE_FIELD_NUMBER: _ClassVar[int]
    WAITED_FOR_INDEX_FIELD_NUMBER: _ClassVar[int]
    name: str
    spec: _channel_pb2.ChannelSpec
    create: bool
    host_name: str
    new_channel_id: bytes
    new_incarnation: int
    created_by: str
    created_max: int
    beside: str
    waited_for_index: int
    def __init__(self, name: _Optional[str] = ..., spec: _Optional[_Union[_channel_pb2.ChannelSpec, _Mapping]] = ..., create: bool = ..., host_name: _Optional[str] = ..., new_channel_id: _Optional[bytes] = ..., new_incarnation: _Optional[int] = ..., created_by: _Optional[str] = ..., created_max: _Optional[int] = ..., beside: _Optional[str] = ..., waited_for_index: _Optional[int] = ...) -> None: ...

class UpdateChannelCommand(_message.Message):
    __slots__ = ("channel_id", "epoch", "spec")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    spec: _channel_pb2.ChannelSpec
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., spec: _Optional[_Union[_channel_pb2.ChannelSpec, _Mapping]] = ...) -> None: ...

class DeleteChannelCommand(_message.Message):
    __slots__ = ("channel_id",)
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    def __init__(self, channel_id: _Optional[bytes] = ...) -> None: ...

class RegisterHostCommand(_message.Message):
    __slots__ = ("host_id", "name", "gatekeepers", "boot_incarnation", "version", "new_incarnation", "registration_epoch", "has_archive", "continues_boot_incarnation", "move_key", "private", "machine", "archive_wait_nanos", "archive_place")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    GATEKEEPERS_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    NEW_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_EPOCH_FIELD_NUMBER: _ClassVar[int]
    HAS_ARCHIVE_FIELD_NUMBER: _ClassVar[int]
    CONTINUES_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    MOVE_KEY_FIELD_NUMBER: _ClassVar[int]
    PRIVATE_FIELD_NUMBER: _ClassVar[int]
    MACHINE_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_PLACE_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    name: str
    gatekeepers: _containers.RepeatedCompositeFieldContainer[_directory_pb2.Endpoint]
    boot_incarnation: int
    version: str
    new_incarnation: int
    registration_epoch: int
    has_archive: bool
    continues_boot_incarnation: int
    move_key: bytes
    private: bool
    machine: str
    archive_wait_nanos: int
    archive_place: str
    def __init__(self, host_id: _Optional[bytes] = ..., name: _Optional[str] = ..., gatekeepers: _Optional[_Iterable[_Union[_directory_pb2.Endpoint, _Mapping]]] = ..., boot_incarnation: _Optional[int] = ..., version: _Optional[str] = ..., new_incarnation: _Optional[int] = ..., registration_epoch: _Optional[int] = ..., has_archive: bool = ..., continues_boot_incarnation: _Optional[int] = ..., move_key: _Optional[bytes] = ..., private: bool = ..., machine: _Optional[str] = ..., archive_wait_nanos: _Optional[int] = ..., archive_place: _Optional[str] = ...) -> None: ...

class DeregisterHostCommand(_message.Message):
    __slots__ = ("host_id", "boot_incarnation")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    boot_incarnation: int
    def __init__(self, host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ...) -> None: ...

class ExpireHostCommand(_message.Message):
    __slots__ = ("host_id", "boot_incarnation", "registered_index", "tenure")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    TENURE_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    boot_incarnation: int
    registered_index: int
    tenure: int
    def __init__(self, host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., registered_index: _Optional[int] = ..., tenure: _Optional[int] = ...) -> None: ...

class NoteHostLoadsCommand(_message.Message):
    __slots__ = ("tenure", "loads")
    TENURE_FIELD_NUMBER: _ClassVar[int]
    LOADS_FIELD_NUMBER: _ClassVar[int]
    tenure: int
    loads: _containers.RepeatedCompositeFieldContainer[ReportedHostLoad]
    def __init__(self, tenure: _Optional[int] = ..., loads: _Optional[_Iterable[_Union[ReportedHostLoad, _Mapping]]] = ...) -> None: ...

class ReportedHostLoad(_message.Message):
    __slots__ = ("host_id", "registered_index", "load")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    LOAD_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    registered_index: int
    load: _directory_pb2.HostLoad
    def __init__(self, host_id: _Optional[bytes] = ..., registered_index: _Optional[int] = ..., load: _Optional[_Union[_directory_pb2.HostLoad, _Mapping]] = ...) -> None: ...

class BeginTenureCommand(_message.Message):
    __slots__ = ("tenure", "supernode_id", "new_cluster_id", "new_lease_ttl_nanos", "founded_anew", "takes_over", "new_feature_level", "new_join_key", "new_token_key")
    TENURE_FIELD_NUMBER: _ClassVar[int]
    SUPERNODE_ID_FIELD_NUMBER: _ClassVar[int]
    NEW_CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    NEW_LEASE_TTL_NANOS_FIELD_NUMBER: _ClassVar[int]
    FOUNDED_ANEW_FIELD_NUMBER: _ClassVar[int]
    TAKES_OVER_FIELD_NUMBER: _ClassVar[int]
    NEW_FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    NEW_JOIN_KEY_FIELD_NUMBER: _ClassVar[int]
    NEW_TOKEN_KEY_FIELD_NUMBER: _ClassVar[int]
    tenure: int
    supernode_id: str
    new_cluster_id: str
    new_lease_ttl_nanos: int
    founded_anew: bool
    takes_over: bool
    new_feature_level: int
    new_join_key: bytes
    new_token_key: bytes
    def __init__(self, tenure: _Optional[int] = ..., supernode_id: _Optional[str] = ..., new_cluster_id: _Optional[str] = ..., new_lease_ttl_nanos: _Optional[int] = ..., founded_anew: bool = ..., takes_over: bool = ..., new_feature_level: _Optional[int] = ..., new_join_key: _Optional[bytes] = ..., new_token_key: _Optional[bytes] = ...) -> None: ...

class OpenGroupCommand(_message.Message):
    __slots__ = ("name", "spec", "create", "new_group_id", "new_incarnation", "created_by", "created_max")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    CREATE_FIELD_NUMBER: _ClassVar[int]
    NEW_GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    NEW_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    CREATED_MAX_FIELD_NUMBER: _ClassVar[int]
    name: str
    spec: _group_pb2.GroupSpec
    create: bool
    new_group_id: bytes
    new_incarnation: int
    created_by: str
    created_max: int
    def __init__(self, name: _Optional[str] = ..., spec: _Optional[_Union[_group_pb2.GroupSpec, _Mapping]] = ..., create: bool = ..., new_group_id: _Optional[bytes] = ..., new_incarnation: _Optional[int] = ..., created_by: _Optional[str] = ..., created_max: _Optional[int] = ...) -> None: ...

class UpdateGroupCommand(_message.Message):
    __slots__ = ("group_id", "add_channel_ids", "remove_channel_ids", "spec_version")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    ADD_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    REMOVE_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    add_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    remove_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    spec_version: int
    def __init__(self, group_id: _Optional[bytes] = ..., add_channel_ids: _Optional[_Iterable[bytes]] = ..., remove_channel_ids: _Optional[_Iterable[bytes]] = ..., spec_version: _Optional[int] = ...) -> None: ...

class DeleteGroupCommand(_message.Message):
    __slots__ = ("group_id",)
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    def __init__(self, group_id: _Optional[bytes] = ...) -> None: ...

class AddReplicaCommand(_message.Message):
    __slots__ = ("subject", "epoch", "host_id", "kind", "source_host_id", "acknowledged")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    SOURCE_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    ACKNOWLEDGED_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    epoch: int
    host_id: bytes
    kind: _replica_pb2.ReplicaKind
    source_host_id: bytes
    acknowledged: bool
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., kind: _Optional[_Union[_replica_pb2.ReplicaKind, str]] = ..., source_host_id: _Optional[bytes] = ..., acknowledged: bool = ...) -> None: ...

class RemoveReplicaCommand(_message.Message):
    __slots__ = ("subject", "host_id", "epoch")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    host_id: bytes
    epoch: int
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., host_id: _Optional[bytes] = ..., epoch: _Optional[int] = ...) -> None: ...

class CommitMoveCommand(_message.Message):
    __slots__ = ("channel_id", "epoch", "to_host_id", "to_boot_incarnation", "permit", "to_registered_index")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    TO_REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    to_host_id: bytes
    to_boot_incarnation: int
    permit: bytes
    to_registered_index: int
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., permit: _Optional[bytes] = ..., to_registered_index: _Optional[int] = ...) -> None: ...

class CommitQueueMoveCommand(_message.Message):
    __slots__ = ("queue_id", "epoch", "to_host_id", "to_boot_incarnation", "permit", "to_registered_index")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    TO_REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    to_host_id: bytes
    to_boot_incarnation: int
    permit: bytes
    to_registered_index: int
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., permit: _Optional[bytes] = ..., to_registered_index: _Optional[int] = ...) -> None: ...

class CommitMovesCommand(_message.Message):
    __slots__ = ("to_host_id", "to_boot_incarnation", "moves", "to_registered_index")
    TO_HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TO_BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    MOVES_FIELD_NUMBER: _ClassVar[int]
    TO_REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    to_host_id: bytes
    to_boot_incarnation: int
    moves: _containers.RepeatedCompositeFieldContainer[_move_pb2.MoveToCommit]
    to_registered_index: int
    def __init__(self, to_host_id: _Optional[bytes] = ..., to_boot_incarnation: _Optional[int] = ..., moves: _Optional[_Iterable[_Union[_move_pb2.MoveToCommit, _Mapping]]] = ..., to_registered_index: _Optional[int] = ...) -> None: ...

class ReleaseMovesCommand(_message.Message):
    __slots__ = ("host_id", "moves")
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    MOVES_FIELD_NUMBER: _ClassVar[int]
    host_id: bytes
    moves: _containers.RepeatedCompositeFieldContainer[_move_pb2.MoveToRelease]
    def __init__(self, host_id: _Optional[bytes] = ..., moves: _Optional[_Iterable[_Union[_move_pb2.MoveToRelease, _Mapping]]] = ...) -> None: ...

class SetReplicaInSyncCommand(_message.Message):
    __slots__ = ("subject", "epoch", "host_id", "boot_incarnation", "in_sync", "change_number", "added_index")
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    IN_SYNC_FIELD_NUMBER: _ClassVar[int]
    CHANGE_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ADDED_INDEX_FIELD_NUMBER: _ClassVar[int]
    subject: _subject_pb2.Subject
    epoch: int
    host_id: bytes
    boot_incarnation: int
    in_sync: bool
    change_number: int
    added_index: int
    def __init__(self, subject: _Optional[_Union[_subject_pb2.Subject, _Mapping]] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., in_sync: bool = ..., change_number: _Optional[int] = ..., added_index: _Optional[int] = ...) -> None: ...

class OpenQueueCommand(_message.Message):
    __slots__ = ("name", "spec", "create", "host_name", "new_queue_id", "new_incarnation", "created_by", "created_max")
    NAME_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    CREATE_FIELD_NUMBER: _ClassVar[int]
    HOST_NAME_FIELD_NUMBER: _ClassVar[int]
    NEW_QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    NEW_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    CREATED_MAX_FIELD_NUMBER: _ClassVar[int]
    name: str
    spec: _queue_pb2.QueueSpec
    create: bool
    host_name: str
    new_queue_id: bytes
    new_incarnation: int
    created_by: str
    created_max: int
    def __init__(self, name: _Optional[str] = ..., spec: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ..., create: bool = ..., host_name: _Optional[str] = ..., new_queue_id: _Optional[bytes] = ..., new_incarnation: _Optional[int] = ..., created_by: _Optional[str] = ..., created_max: _Optional[int] = ...) -> None: ...

class UpdateQueueCommand(_message.Message):
    __slots__ = ("queue_id", "epoch", "spec")
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SPEC_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    epoch: int
    spec: _queue_pb2.QueueSpec
    def __init__(self, queue_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., spec: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ...) -> None: ...

class DeleteQueueCommand(_message.Message):
    __slots__ = ("queue_id",)
    QUEUE_ID_FIELD_NUMBER: _ClassVar[int]
    queue_id: bytes
    def __init__(self, queue_id: _Optional[bytes] = ...) -> None: ...

class RegisterPeerCommand(_message.Message):
    __slots__ = ("peer_id", "name", "boot_incarnation", "proof_sha256", "mailbox", "mailbox_host_name", "host_id", "zone", "version", "attributes", "new_mailbox_id", "new_incarnation", "registration_epoch", "owner", "created_by", "created_max")
    class AttributesEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: str
        def __init__(self, key: _Optional[str] = ..., value: _Optional[str] = ...) -> None: ...
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PROOF_SHA256_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_HOST_NAME_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    ZONE_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTES_FIELD_NUMBER: _ClassVar[int]
    NEW_MAILBOX_ID_FIELD_NUMBER: _ClassVar[int]
    NEW_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_EPOCH_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    CREATED_MAX_FIELD_NUMBER: _ClassVar[int]
    peer_id: bytes
    name: str
    boot_incarnation: int
    proof_sha256: bytes
    mailbox: _queue_pb2.QueueSpec
    mailbox_host_name: str
    host_id: bytes
    zone: str
    version: str
    attributes: _containers.ScalarMap[str, str]
    new_mailbox_id: bytes
    new_incarnation: int
    registration_epoch: int
    owner: str
    created_by: str
    created_max: int
    def __init__(self, peer_id: _Optional[bytes] = ..., name: _Optional[str] = ..., boot_incarnation: _Optional[int] = ..., proof_sha256: _Optional[bytes] = ..., mailbox: _Optional[_Union[_queue_pb2.QueueSpec, _Mapping]] = ..., mailbox_host_name: _Optional[str] = ..., host_id: _Optional[bytes] = ..., zone: _Optional[str] = ..., version: _Optional[str] = ..., attributes: _Optional[_Mapping[str, str]] = ..., new_mailbox_id: _Optional[bytes] = ..., new_incarnation: _Optional[int] = ..., registration_epoch: _Optional[int] = ..., owner: _Optional[str] = ..., created_by: _Optional[str] = ..., created_max: _Optional[int] = ...) -> None: ...

class DeregisterPeerCommand(_message.Message):
    __slots__ = ("peer_id", "boot_incarnation")
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    peer_id: bytes
    boot_incarnation: int
    def __init__(self, peer_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ...) -> None: ...

class ExpirePeersCommand(_message.Message):
    __slots__ = ("leases", "tenure")
    LEASES_FIELD_NUMBER: _ClassVar[int]
    TENURE_FIELD_NUMBER: _ClassVar[int]
    leases: _containers.RepeatedCompositeFieldContainer[PeerLease]
    tenure: int
    def __init__(self, leases: _Optional[_Iterable[_Union[PeerLease, _Mapping]]] = ..., tenure: _Optional[int] = ...) -> None: ...

class PeerLease(_message.Message):
    __slots__ = ("peer_id", "boot_incarnation", "registered_index")
    PEER_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    peer_id: bytes
    boot_incarnation: int
    registered_index: int
    def __init__(self, peer_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., registered_index: _Optional[int] = ...) -> None: ...

class DirectoryResult(_message.Message):
    __slots__ = ("refused", "channel_opened", "channel_updated", "channel_deleted", "host_registered", "host_deregistered", "host_expired", "tenure_begun", "group_opened", "group_updated", "group_deleted", "replica_added", "replica_removed", "replica_in_sync_set", "queue_opened", "queue_updated", "queue_deleted", "peer_registered", "peer_deregistered", "peers_expired", "time_marked", "feature_level_raised", "token_key_created", "access_rule_added", "access_rule_removed", "credential_revoked", "quotas_set", "quotas_removed", "host_loads_noted", "move_committed", "queue_move_committed", "moves_committed", "moves_released")
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_OPENED_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_UPDATED_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_DELETED_FIELD_NUMBER: _ClassVar[int]
    HOST_REGISTERED_FIELD_NUMBER: _ClassVar[int]
    HOST_DEREGISTERED_FIELD_NUMBER: _ClassVar[int]
    HOST_EXPIRED_FIELD_NUMBER: _ClassVar[int]
    TENURE_BEGUN_FIELD_NUMBER: _ClassVar[int]
    GROUP_OPENED_FIELD_NUMBER: _ClassVar[int]
    GROUP_UPDATED_FIELD_NUMBER: _ClassVar[int]
    GROUP_DELETED_FIELD_NUMBER: _ClassVar[int]
    REPLICA_ADDED_FIELD_NUMBER: _ClassVar[int]
    REPLICA_REMOVED_FIELD_NUMBER: _ClassVar[int]
    REPLICA_IN_SYNC_SET_FIELD_NUMBER: _ClassVar[int]
    QUEUE_OPENED_FIELD_NUMBER: _ClassVar[int]
    QUEUE_UPDATED_FIELD_NUMBER: _ClassVar[int]
    QUEUE_DELETED_FIELD_NUMBER: _ClassVar[int]
    PEER_REGISTERED_FIELD_NUMBER: _ClassVar[int]
    PEER_DEREGISTERED_FIELD_NUMBER: _ClassVar[int]
    PEERS_EXPIRED_FIELD_NUMBER: _ClassVar[int]
    TIME_MARKED_FIELD_NUMBER: _ClassVar[int]
    FEATURE_LEVEL_RAISED_FIELD_NUMBER: _ClassVar[int]
    TOKEN_KEY_CREATED_FIELD_NUMBER: _ClassVar[int]
    ACCESS_RULE_ADDED_FIELD_NUMBER: _ClassVar[int]
    ACCESS_RULE_REMOVED_FIELD_NUMBER: _ClassVar[int]
    CREDENTIAL_REVOKED_FIELD_NUMBER: _ClassVar[int]
    QUOTAS_SET_FIELD_NUMBER: _ClassVar[int]
    QUOTAS_REMOVED_FIELD_NUMBER: _ClassVar[int]
    HOST_LOADS_NOTED_FIELD_NUMBER: _ClassVar[int]
    MOVE_COMMITTED_FIELD_NUMBER: _ClassVar[int]
    QUEUE_MOVE_COMMITTED_FIELD_NUMBER: _ClassVar[int]
    MOVES_COMMITTED_FIELD_NUMBER: _ClassVar[int]
    MOVES_RELEASED_FIELD_NUMBER: _ClassVar[int]
    refused: RefusedResult
    channel_opened: ChannelOpenedResult
    channel_updated: ChannelUpdatedResult
    channel_deleted: ChannelDeletedResult
    host_registered: HostRegisteredResult
    host_deregistered: HostDeregisteredResult
    host_expired: HostExpiredResult
    tenure_begun: TenureBegunResult
    group_opened: GroupOpenedResult
    group_updated: GroupUpdatedResult
    group_deleted: GroupDeletedResult
    replica_added: ReplicaAddedResult
    replica_removed: ReplicaRemovedResult
    replica_in_sync_set: ReplicaInSyncSetResult
    queue_opened: QueueOpenedResult
    queue_updated: QueueUpdatedResult
    queue_deleted: QueueDeletedResult
    peer_registered: PeerRegisteredResult
    peer_deregistered: PeerDeregisteredResult
    peers_expired: PeersExpiredResult
    time_marked: TimeMarkedResult
    feature_level_raised: FeatureLevelRaisedResult
    token_key_created: TokenKeyCreatedResult
    access_rule_added: AccessRuleAddedResult
    access_rule_removed: AccessRuleRemovedResult
    credential_revoked: CredentialRevokedResult
    quotas_set: QuotasSetResult
    quotas_removed: QuotasRemovedResult
    host_loads_noted: HostLoadsNotedResult
    move_committed: MoveCommittedResult
    queue_move_committed: QueueMoveCommittedResult
    moves_committed: MovesCommittedResult
    moves_released: MovesReleasedResult
    def __init__(self, refused: _Optional[_Union[RefusedResult, _Mapping]] = ..., channel_opened: _Optional[_Union[ChannelOpenedResult, _Mapping]] = ..., channel_updated: _Optional[_Union[ChannelUpdatedResult, _Mapping]] = ..., channel_deleted: _Optional[_Union[ChannelDeletedResult, _Mapping]] = ..., host_registered: _Optional[_Union[HostRegisteredResult, _Mapping]] = ..., host_deregistered: _Optional[_Union[HostDeregisteredResult, _Mapping]] = ..., host_expired: _Optional[_Union[HostExpiredResult, _Mapping]] = ..., tenure_begun: _Optional[_Union[TenureBegunResult, _Mapping]] = ..., group_opened: _Optional[_Union[GroupOpenedResult, _Mapping]] = ..., group_updated: _Optional[_Union[GroupUpdatedResult, _Mapping]] = ..., group_deleted: _Optional[_Union[GroupDeletedResult, _Mapping]] = ..., replica_added: _Optional[_Union[ReplicaAddedResult, _Mapping]] = ..., replica_removed: _Optional[_Union[ReplicaRemovedResult, _Mapping]] = ..., replica_in_sync_set: _Optional[_Union[ReplicaInSyncSetResult, _Mapping]] = ..., queue_opened: _Optional[_Union[QueueOpenedResult, _Mapping]] = ..., queue_updated: _Optional[_Union[QueueUpdatedResult, _Mapping]] = ..., queue_deleted: _Optional[_Union[QueueDeletedResult, _Mapping]] = ..., peer_registered: _Optional[_Union[PeerRegisteredResult, _Mapping]] = ..., peer_deregistered: _Optional[_Union[PeerDeregisteredResult, _Mapping]] = ..., peers_expired: _Optional[_Union[PeersExpiredResult, _Mapping]] = ..., time_marked: _Optional[_Union[TimeMarkedResult, _Mapping]] = ..., feature_level_raised: _Optional[_Union[FeatureLevelRaisedResult, _Mapping]] = ..., token_key_created: _Optional[_Union[TokenKeyCreatedResult, _Mapping]] = ..., access_rule_added: _Optional[_Union[AccessRuleAddedResult, _Mapping]] = ..., access_rule_removed: _Optional[_Union[AccessRuleRemovedResult, _Mapping]] = ..., credential_revoked: _Optional[_Union[CredentialRevokedResult, _Mapping]] = ..., quotas_set: _Optional[_Union[QuotasSetResult, _Mapping]] = ..., quotas_removed: _Optional[_Union[QuotasRemovedResult, _Mapping]] = ..., host_loads_noted: _Optional[_Union[HostLoadsNotedResult, _Mapping]] = ..., move_committed: _Optional[_Union[MoveCommittedResult, _Mapping]] = ..., queue_move_committed: _Optional[_Union[QueueMoveCommittedResult, _Mapping]] = ..., moves_committed: _Optional[_Union[MovesCommittedResult, _Mapping]] = ..., moves_released: _Optional[_Union[MovesReleasedResult, _Mapping]] = ...) -> None: ...

class TokenKeyCreatedResult(_message.Message):
    __slots__ = ("version",)
    VERSION_FIELD_NUMBER: _ClassVar[int]
    version: int
    def __init__(self, version: _Optional[int] = ...) -> None: ...

class CredentialRevokedResult(_message.Message):
    __slots__ = ("revoked", "version")
    REVOKED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    revoked: bool
    version: int
    def __init__(self, revoked: bool = ..., version: _Optional[int] = ...) -> None: ...

class QuotasSetResult(_message.Message):
    __slots__ = ("changed", "version")
    CHANGED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    changed: bool
    version: int
    def __init__(self, changed: bool = ..., version: _Optional[int] = ...) -> None: ...

class QuotasRemovedResult(_message.Message):
    __slots__ = ("removed", "version")
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    removed: int
    version: int
    def __init__(self, removed: _Optional[int] = ..., version: _Optional[int] = ...) -> None: ...

class AccessRuleAddedResult(_message.Message):
    __slots__ = ("added", "version")
    ADDED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    added: bool
    version: int
    def __init__(self, added: bool = ..., version: _Optional[int] = ...) -> None: ...

class AccessRuleRemovedResult(_message.Message):
    __slots__ = ("removed", "version")
    REMOVED_FIELD_NUMBER: _ClassVar[int]
    VERSION_FIELD_NUMBER: _ClassVar[int]
    removed: bool
    version: int
    def __init__(self, removed: bool = ..., version: _Optional[int] = ...) -> None: ...

class FeatureLevelRaisedResult(_message.Message):
    __slots__ = ("feature_level",)
    FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    feature_level: int
    def __init__(self, feature_level: _Optional[int] = ...) -> None: ...

class TimeMarkedResult(_message.Message):
    __slots__ = ("marked",)
    MARKED_FIELD_NUMBER: _ClassVar[int]
    marked: bool
    def __init__(self, marked: bool = ...) -> None: ...

class RefusedResult(_message.Message):
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
    reason: str
    message: str
    metadata: _containers.ScalarMap[str, str]
    def __init__(self, reason: _Optional[str] = ..., message: _Optional[str] = ..., metadata: _Optional[_Mapping[str, str]] = ...) -> None: ...

class ChannelOpenedResult(_message.Message):
    __slots__ = ("channel", "host", "created")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    host: HostEntry
    created: bool
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., host: _Optional[_Union[HostEntry, _Mapping]] = ..., created: bool = ...) -> None: ...

class ChannelUpdatedResult(_message.Message):
    __slots__ = ("channel",)
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ...) -> None: ...

class ChannelDeletedResult(_message.Message):
    __slots__ = ("channel", "freed_groups")
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    FREED_GROUPS_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    freed_groups: FreedGroups
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., freed_groups: _Optional[_Union[FreedGroups, _Mapping]] = ...) -> None: ...

class FreedGroups(_message.Message):
    __slots__ = ("names",)
    NAMES_FIELD_NUMBER: _ClassVar[int]
    names: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, names: _Optional[_Iterable[str]] = ...) -> None: ...

class HostRegisteredResult(_message.Message):
    __slots__ = ("host", "cluster_id")
    HOST_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    host: HostEntry
    cluster_id: str
    def __init__(self, host: _Optional[_Union[HostEntry, _Mapping]] = ..., cluster_id: _Optional[str] = ...) -> None: ...

class HostDeregisteredResult(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class HostExpiredResult(_message.Message):
    __slots__ = ("expired",)
    EXPIRED_FIELD_NUMBER: _ClassVar[int]
    expired: bool
    def __init__(self, expired: bool = ...) -> None: ...

class HostLoadsNotedResult(_message.Message):
    __slots__ = ("noted",)
    NOTED_FIELD_NUMBER: _ClassVar[int]
    noted: int
    def __init__(self, noted: _Optional[int] = ...) -> None: ...

class TenureBegunResult(_message.Message):
    __slots__ = ("tenure", "cluster_id")
    TENURE_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    tenure: int
    cluster_id: str
    def __init__(self, tenure: _Optional[int] = ..., cluster_id: _Optional[str] = ...) -> None: ...

class GroupOpenedResult(_message.Message):
    __slots__ = ("group", "created")
    GROUP_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    group: _group_pb2.GroupRecord
    created: bool
    def __init__(self, group: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ..., created: bool = ...) -> None: ...

class GroupUpdatedResult(_message.Message):
    __slots__ = ("group",)
    GROUP_FIELD_NUMBER: _ClassVar[int]
    group: _group_pb2.GroupRecord
    def __init__(self, group: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ...) -> None: ...

class GroupDeletedResult(_message.Message):
    __slots__ = ("name",)
    NAME_FIELD_NUMBER: _ClassVar[int]
    name: str
    def __init__(self, name: _Optional[str] = ...) -> None: ...

class ReplicaAddedResult(_message.Message):
    __slots__ = ("replica", "host")
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    replica: _replica_pb2.ReplicaRecord
    host: HostEntry
    def __init__(self, replica: _Optional[_Union[_replica_pb2.ReplicaRecord, _Mapping]] = ..., host: _Optional[_Union[HostEntry, _Mapping]] = ...) -> None: ...

class ReplicaRemovedResult(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class ReplicaInSyncSetResult(_message.Message):
    __slots__ = ("replica",)
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    replica: _replica_pb2.ReplicaRecord
    def __init__(self, replica: _Optional[_Union[_replica_pb2.ReplicaRecord, _Mapping]] = ...) -> None: ...

class MoveCommittedResult(_message.Message):
    __slots__ = ("channel",)
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    channel: _channel_pb2.ChannelRecord
    def __init__(self, channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ...) -> None: ...

class MovesCommittedResult(_message.Message):
    __slots__ = ("channels",)
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    def __init__(self, channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ...) -> None: ...

class MovesReleasedResult(_message.Message):
    __slots__ = ("channel_ids",)
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class QueueMoveCommittedResult(_message.Message):
    __slots__ = ("queue",)
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class QueueOpenedResult(_message.Message):
    __slots__ = ("queue", "host", "created")
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    HOST_FIELD_NUMBER: _ClassVar[int]
    CREATED_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    host: HostEntry
    created: bool
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., host: _Optional[_Union[HostEntry, _Mapping]] = ..., created: bool = ...) -> None: ...

class QueueUpdatedResult(_message.Message):
    __slots__ = ("queue",)
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class QueueDeletedResult(_message.Message):
    __slots__ = ("queue",)
    QUEUE_FIELD_NUMBER: _ClassVar[int]
    queue: _queue_pb2.QueueRecord
    def __init__(self, queue: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ...) -> None: ...

class PeerRegisteredResult(_message.Message):
    __slots__ = ("peer", "mailbox", "mailbox_host", "mailbox_kept", "cluster_id")
    PEER_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_HOST_FIELD_NUMBER: _ClassVar[int]
    MAILBOX_KEPT_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    peer: PeerEntry
    mailbox: _queue_pb2.QueueRecord
    mailbox_host: HostEntry
    mailbox_kept: bool
    cluster_id: str
    def __init__(self, peer: _Optional[_Union[PeerEntry, _Mapping]] = ..., mailbox: _Optional[_Union[_queue_pb2.QueueRecord, _Mapping]] = ..., mailbox_host: _Optional[_Union[HostEntry, _Mapping]] = ..., mailbox_kept: bool = ..., cluster_id: _Optional[str] = ...) -> None: ...

class PeerDeregisteredResult(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class PeersExpiredResult(_message.Message):
    __slots__ = ("expired",)
    EXPIRED_FIELD_NUMBER: _ClassVar[int]
    expired: int
    def __init__(self, expired: _Optional[int] = ...) -> None: ...

class PeerEntry(_message.Message):
    __slots__ = ("record", "proof_sha256", "registered_index", "ended_index", "created_by")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    PROOF_SHA256_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    ENDED_INDEX_FIELD_NUMBER: _ClassVar[int]
    CREATED_BY_FIELD_NUMBER: _ClassVar[int]
    record: _peer_pb2.PeerRecord
    proof_sha256: bytes
    registered_index: int
    ended_index: int
    created_by: str
    def __init__(self, record: _Optional[_Union[_peer_pb2.PeerRecord, _Mapping]] = ..., proof_sha256: _Optional[bytes] = ..., registered_index: _Optional[int] = ..., ended_index: _Optional[int] = ..., created_by: _Optional[str] = ...) -> None: ...

class GroupEntry(_message.Message):
    __slots__ = ("record", "witness_host_ids")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    WITNESS_HOST_IDS_FIELD_NUMBER: _ClassVar[int]
    record: _group_pb2.GroupRecord
    witness_host_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, record: _Optional[_Union[_group_pb2.GroupRecord, _Mapping]] = ..., witness_host_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class HostEntry(_message.Message):
    __slots__ = ("record", "registered_index", "move_key", "archive_wait_nanos")
    RECORD_FIELD_NUMBER: _ClassVar[int]
    REGISTERED_INDEX_FIELD_NUMBER: _ClassVar[int]
    MOVE_KEY_FIELD_NUMBER: _ClassVar[int]
    ARCHIVE_WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    record: _directory_pb2.HostRecord
    registered_index: int
    move_key: bytes
    archive_wait_nanos: int
    def __init__(self, record: _Optional[_Union[_directory_pb2.HostRecord, _Mapping]] = ..., registered_index: _Optional[int] = ..., move_key: _Optional[bytes] = ..., archive_wait_nanos: _Optional[int] = ...) -> None: ...

class RememberedOperation(_message.Message):
    __slots__ = ("op_id", "log_index", "subject", "result", "caller")
    OP_ID_FIELD_NUMBER: _ClassVar[int]
    LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    SUBJECT_FIELD_NUMBER: _ClassVar[int]
    RESULT_FIELD_NUMBER: _ClassVar[int]
    CALLER_FIELD_NUMBER: _ClassVar[int]
    op_id: bytes
    log_index: int
    subject: str
    result: DirectoryResult
    caller: str
    def __init__(self, op_id: _Optional[bytes] = ..., log_index: _Optional[int] = ..., subject: _Optional[str] = ..., result: _Optional[_Union[DirectoryResult, _Mapping]] = ..., caller: _Optional[str] = ...) -> None: ...

class DirectorySnapshot(_message.Message):
    __slots__ = ("format_version", "applied_index", "tenure", "cluster_id", "hosts", "channels", "remembered_operations", "lease_ttl_nanos", "groups", "replicas", "queues", "peers", "time_marks", "former_cluster_ids", "digest", "feature_level", "join_key", "access_rules", "token_key", "access_version", "revoked_serials", "quotas")
    FORMAT_VERSION_FIELD_NUMBER: _ClassVar[int]
    APPLIED_INDEX_FIELD_NUMBER: _ClassVar[int]
    TENURE_FIELD_NUMBER: _ClassVar[int]
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    HOSTS_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    REMEMBERED_OPERATIONS_FIELD_NUMBER: _ClassVar[int]
    LEASE_TTL_NANOS_FIELD_NUMBER: _ClassVar[int]
    GROUPS_FIELD_NUMBER: _ClassVar[int]
    REPLICAS_FIELD_NUMBER: _ClassVar[int]
    QUEUES_FIELD_NUMBER: _ClassVar[int]
    PEERS_FIELD_NUMBER: _ClassVar[int]
    TIME_MARKS_FIELD_NUMBER: _ClassVar[int]
    FORMER_CLUSTER_IDS_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    JOIN_KEY_FIELD_NUMBER: _ClassVar[int]
    ACCESS_RULES_FIELD_NUMBER: _ClassVar[int]
    TOKEN_KEY_FIELD_NUMBER: _ClassVar[int]
    ACCESS_VERSION_FIELD_NUMBER: _ClassVar[int]
    REVOKED_SERIALS_FIELD_NUMBER: _ClassVar[int]
    QUOTAS_FIELD_NUMBER: _ClassVar[int]
    format_version: int
    applied_index: int
    tenure: int
    cluster_id: str
    hosts: _containers.RepeatedCompositeFieldContainer[HostEntry]
    channels: _containers.RepeatedCompositeFieldContainer[_channel_pb2.ChannelRecord]
    remembered_operations: _containers.RepeatedCompositeFieldContainer[RememberedOperation]
    lease_ttl_nanos: int
    groups: _containers.RepeatedCompositeFieldContainer[GroupEntry]
    replicas: _containers.RepeatedCompositeFieldContainer[_replica_pb2.ReplicaRecord]
    queues: _containers.RepeatedCompositeFieldContainer[_queue_pb2.QueueRecord]
    peers: _containers.RepeatedCompositeFieldContainer[PeerEntry]
    time_marks: _containers.RepeatedScalarFieldContainer[int]
    former_cluster_ids: _containers.RepeatedScalarFieldContainer[str]
    digest: bytes
    feature_level: int
    join_key: bytes
    access_rules: _containers.RepeatedCompositeFieldContainer[_access_pb2.AccessRule]
    token_key: bytes
    access_version: int
    revoked_serials: _containers.RepeatedScalarFieldContainer[str]
    quotas: _containers.RepeatedCompositeFieldContainer[_quota_pb2.QuotaSetting]
    def __init__(self, format_version: _Optional[int] = ..., applied_index: _Optional[int] = ..., tenure: _Optional[int] = ..., cluster_id: _Optional[str] = ..., hosts: _Optional[_Iterable[_Union[HostEntry, _Mapping]]] = ..., channels: _Optional[_Iterable[_Union[_channel_pb2.ChannelRecord, _Mapping]]] = ..., remembered_operations: _Optional[_Iterable[_Union[RememberedOperation, _Mapping]]] = ..., lease_ttl_nanos: _Optional[int] = ..., groups: _Optional[_Iterable[_Union[GroupEntry, _Mapping]]] = ..., replicas: _Optional[_Iterable[_Union[_replica_pb2.ReplicaRecord, _Mapping]]] = ..., queues: _Optional[_Iterable[_Union[_queue_pb2.QueueRecord, _Mapping]]] = ..., peers: _Optional[_Iterable[_Union[PeerEntry, _Mapping]]] = ..., time_marks: _Optional[_Iterable[int]] = ..., former_cluster_ids: _Optional[_Iterable[str]] = ..., digest: _Optional[bytes] = ..., feature_level: _Optional[int] = ..., join_key: _Optional[bytes] = ..., access_rules: _Optional[_Iterable[_Union[_access_pb2.AccessRule, _Mapping]]] = ..., token_key: _Optional[bytes] = ..., access_version: _Optional[int] = ..., revoked_serials: _Optional[_Iterable[str]] = ..., quotas: _Optional[_Iterable[_Union[_quota_pb2.QuotaSetting, _Mapping]]] = ...) -> None: ...
