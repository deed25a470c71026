from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class RaftRefusal(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    RAFT_REFUSAL_UNSPECIFIED: _ClassVar[RaftRefusal]
    RAFT_REFUSAL_QUEUE_FULL: _ClassVar[RaftRefusal]
    RAFT_REFUSAL_MISSING_LEADER: _ClassVar[RaftRefusal]
    RAFT_REFUSAL_NOT_LEADER: _ClassVar[RaftRefusal]
    RAFT_REFUSAL_DENIED: _ClassVar[RaftRefusal]
RAFT_REFUSAL_UNSPECIFIED: RaftRefusal
RAFT_REFUSAL_QUEUE_FULL: RaftRefusal
RAFT_REFUSAL_MISSING_LEADER: RaftRefusal
RAFT_REFUSAL_NOT_LEADER: RaftRefusal
RAFT_REFUSAL_DENIED: RaftRefusal

class RaftServiceExchangeRequest(_message.Message):
    __slots__ = ("hello", "messages")
    HELLO_FIELD_NUMBER: _ClassVar[int]
    MESSAGES_FIELD_NUMBER: _ClassVar[int]
    hello: RaftHello
    messages: _containers.RepeatedCompositeFieldContainer[RaftMessage]
    def __init__(self, hello: _Optional[_Union[RaftHello, _Mapping]] = ..., messages: _Optional[_Iterable[_Union[RaftMessage, _Mapping]]] = ...) -> None: ...

class RaftServiceExchangeResponse(_message.Message):
    __slots__ = ("protocol_version", "members", "unknown_caller")
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    MEMBERS_FIELD_NUMBER: _ClassVar[int]
    UNKNOWN_CALLER_FIELD_NUMBER: _ClassVar[int]
    protocol_version: int
    members: _containers.RepeatedCompositeFieldContainer[RaftMember]
    unknown_caller: bool
    def __init__(self, protocol_version: _Optional[int] = ..., members: _Optional[_Iterable[_Union[RaftMember, _Mapping]]] = ..., unknown_caller: bool = ...) -> None: ...

class RaftMember(_message.Message):
    __slots__ = ("member_id", "address")
    MEMBER_ID_FIELD_NUMBER: _ClassVar[int]
    ADDRESS_FIELD_NUMBER: _ClassVar[int]
    member_id: str
    address: str
    def __init__(self, member_id: _Optional[str] = ..., address: _Optional[str] = ...) -> None: ...

class RaftConfiguration(_message.Message):
    __slots__ = ("members", "retired_ids", "spent_tickets")
    MEMBERS_FIELD_NUMBER: _ClassVar[int]
    RETIRED_IDS_FIELD_NUMBER: _ClassVar[int]
    SPENT_TICKETS_FIELD_NUMBER: _ClassVar[int]
    members: _containers.RepeatedCompositeFieldContainer[RaftMember]
    retired_ids: _containers.RepeatedScalarFieldContainer[str]
    spent_tickets: _containers.RepeatedCompositeFieldContainer[RaftSpentTicket]
    def __init__(self, members: _Optional[_Iterable[_Union[RaftMember, _Mapping]]] = ..., retired_ids: _Optional[_Iterable[str]] = ..., spent_tickets: _Optional[_Iterable[_Union[RaftSpentTicket, _Mapping]]] = ...) -> None: ...

class RaftSpentTicket(_message.Message):
    __slots__ = ("ticket_sha256", "member_id")
    TICKET_SHA256_FIELD_NUMBER: _ClassVar[int]
    MEMBER_ID_FIELD_NUMBER: _ClassVar[int]
    ticket_sha256: str
    member_id: str
    def __init__(self, ticket_sha256: _Optional[str] = ..., member_id: _Optional[str] = ...) -> None: ...

class RaftHello(_message.Message):
    __slots__ = ("cluster_id", "member_id", "peer_member_id", "protocol_version", "store_id", "term", "last_log_index", "address", "highest_feature_level")
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    MEMBER_ID_FIELD_NUMBER: _ClassVar[int]
    PEER_MEMBER_ID_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    STORE_ID_FIELD_NUMBER: _ClassVar[int]
    TERM_FIELD_NUMBER: _ClassVar[int]
    LAST_LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    ADDRESS_FIELD_NUMBER: _ClassVar[int]
    HIGHEST_FEATURE_LEVEL_FIELD_NUMBER: _ClassVar[int]
    cluster_id: str
    member_id: str
    peer_member_id: str
    protocol_version: int
    store_id: str
    term: int
    last_log_index: int
    address: str
    highest_feature_level: int
    def __init__(self, cluster_id: _Optional[str] = ..., member_id: _Optional[str] = ..., peer_member_id: _Optional[str] = ..., protocol_version: _Optional[int] = ..., store_id: _Optional[str] = ..., term: _Optional[int] = ..., last_log_index: _Optional[int] = ..., address: _Optional[str] = ..., highest_feature_level: _Optional[int] = ...) -> None: ...

class RaftMessage(_message.Message):
    __slots__ = ("append_entries", "append_reply", "vote_request", "vote_reply", "forwarded_command", "forwarded_command_reply", "read_index_request", "read_index_reply", "timeout_now")
    APPEND_ENTRIES_FIELD_NUMBER: _ClassVar[int]
    APPEND_REPLY_FIELD_NUMBER: _ClassVar[int]
    VOTE_REQUEST_FIELD_NUMBER: _ClassVar[int]
    VOTE_REPLY_FIELD_NUMBER: _ClassVar[int]
    FORWARDED_COMMAND_FIELD_NUMBER: _ClassVar[int]
    FORWARDED_COMMAND_REPLY_FIELD_NUMBER: _ClassVar[int]
    READ_INDEX_REQUEST_FIELD_NUMBER: _ClassVar[int]
    READ_INDEX_REPLY_FIELD_NUMBER: _ClassVar[int]
    TIMEOUT_NOW_FIELD_NUMBER: _ClassVar[int]
    append_entries: RaftAppendEntries
    append_reply: RaftAppendReply
    vote_request: RaftVoteRequest
    vote_reply: RaftVoteReply
    forwarded_command: RaftForwardedCommand
    forwarded_command_reply: RaftForwardedCommandReply
    read_index_request: RaftReadIndexRequest
    read_index_reply: RaftReadIndexReply
    timeout_now: RaftTimeoutNow
    def __init__(self, append_entries: _Optional[_Union[RaftAppendEntries, _Mapping]] = ..., append_reply: _Optional[_Union[RaftAppendReply, _Mapping]] = ..., vote_request: _Optional[_Union[RaftVoteRequest, _Mapping]] = ..., vote_reply: _Optional[_Union[RaftVoteReply, _Mapping]] = ..., forwarded_command: _Optional[_Union[RaftForwardedCommand, _Mapping]] = ..., forwarded_command_reply: _Optional[_Union[RaftForwardedCommandReply, _Mapping]] = ..., read_index_request: _Optional[_Union[RaftReadIndexRequest, _Mapping]] = ..., read_index_reply: _Optional[_Union[RaftReadIndexReply, _Mapping]] = ..., timeout_now: _Optional[_Union[RaftTimeoutNow, _Mapping]] = ...) -> None: ...

class RaftLogEntry(_message.Message):
    __slots__ = ("log_index", "term", "command")
    LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    TERM_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    log_index: int
    term: int
    command: bytes
    def __init__(self, log_index: _Optional[int] = ..., term: _Optional[int] = ..., command: _Optional[bytes] = ...) -> None: ...

class RaftAppendEntries(_message.Message):
    __slots__ = ("term", "commit_index", "round", "previous_log_index", "previous_log_term", "entries", "installing_snapshot", "chunk", "digest_index", "digest", "most_digest_index", "most_digest")
    TERM_FIELD_NUMBER: _ClassVar[int]
    COMMIT_INDEX_FIELD_NUMBER: _ClassVar[int]
    ROUND_FIELD_NUMBER: _ClassVar[int]
    PREVIOUS_LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    PREVIOUS_LOG_TERM_FIELD_NUMBER: _ClassVar[int]
    ENTRIES_FIELD_NUMBER: _ClassVar[int]
    INSTALLING_SNAPSHOT_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    DIGEST_INDEX_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    MOST_DIGEST_INDEX_FIELD_NUMBER: _ClassVar[int]
    MOST_DIGEST_FIELD_NUMBER: _ClassVar[int]
    term: int
    commit_index: int
    round: int
    previous_log_index: int
    previous_log_term: int
    entries: _containers.RepeatedCompositeFieldContainer[RaftLogEntry]
    installing_snapshot: bool
    chunk: RaftSnapshotChunk
    digest_index: int
    digest: bytes
    most_digest_index: int
    most_digest: bytes
    def __init__(self, term: _Optional[int] = ..., commit_index: _Optional[int] = ..., round: _Optional[int] = ..., previous_log_index: _Optional[int] = ..., previous_log_term: _Optional[int] = ..., entries: _Optional[_Iterable[_Union[RaftLogEntry, _Mapping]]] = ..., installing_snapshot: bool = ..., chunk: _Optional[_Union[RaftSnapshotChunk, _Mapping]] = ..., digest_index: _Optional[int] = ..., digest: _Optional[bytes] = ..., most_digest_index: _Optional[int] = ..., most_digest: _Optional[bytes] = ...) -> None: ...

class RaftSnapshotChunk(_message.Message):
    __slots__ = ("last_log_index", "offset_bytes", "total_bytes", "sha256", "data")
    LAST_LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    OFFSET_BYTES_FIELD_NUMBER: _ClassVar[int]
    TOTAL_BYTES_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    last_log_index: int
    offset_bytes: int
    total_bytes: int
    sha256: bytes
    data: bytes
    def __init__(self, last_log_index: _Optional[int] = ..., offset_bytes: _Optional[int] = ..., total_bytes: _Optional[int] = ..., sha256: _Optional[bytes] = ..., data: _Optional[bytes] = ...) -> None: ...

class RaftAppendReply(_message.Message):
    __slots__ = ("term", "round", "next_index", "reset", "success", "digest_index", "digest")
    TERM_FIELD_NUMBER: _ClassVar[int]
    ROUND_FIELD_NUMBER: _ClassVar[int]
    NEXT_INDEX_FIELD_NUMBER: _ClassVar[int]
    RESET_FIELD_NUMBER: _ClassVar[int]
    SUCCESS_FIELD_NUMBER: _ClassVar[int]
    DIGEST_INDEX_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    term: int
    round: int
    next_index: int
    reset: bool
    success: bool
    digest_index: int
    digest: bytes
    def __init__(self, term: _Optional[int] = ..., round: _Optional[int] = ..., next_index: _Optional[int] = ..., reset: bool = ..., success: bool = ..., digest_index: _Optional[int] = ..., digest: _Optional[bytes] = ...) -> None: ...

class RaftVoteRequest(_message.Message):
    __slots__ = ("term", "last_log_index", "last_log_term", "pre_vote")
    TERM_FIELD_NUMBER: _ClassVar[int]
    LAST_LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    LAST_LOG_TERM_FIELD_NUMBER: _ClassVar[int]
    PRE_VOTE_FIELD_NUMBER: _ClassVar[int]
    term: int
    last_log_index: int
    last_log_term: int
    pre_vote: bool
    def __init__(self, term: _Optional[int] = ..., last_log_index: _Optional[int] = ..., last_log_term: _Optional[int] = ..., pre_vote: bool = ...) -> None: ...

class RaftVoteReply(_message.Message):
    __slots__ = ("term", "pre_vote", "voter_term")
    TERM_FIELD_NUMBER: _ClassVar[int]
    PRE_VOTE_FIELD_NUMBER: _ClassVar[int]
    VOTER_TERM_FIELD_NUMBER: _ClassVar[int]
    term: int
    pre_vote: bool
    voter_term: int
    def __init__(self, term: _Optional[int] = ..., pre_vote: bool = ..., voter_term: _Optional[int] = ...) -> None: ...

class RaftTimeoutNow(_message.Message):
    __slots__ = ("term",)
    TERM_FIELD_NUMBER: _ClassVar[int]
    term: int
    def __init__(self, term: _Optional[int] = ...) -> None: ...

class RaftForwardedCommand(_message.Message):
    __slots__ = ("request_id", "command")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    COMMAND_FIELD_NUMBER: _ClassVar[int]
    request_id: int
    command: bytes
    def __init__(self, request_id: _Optional[int] = ..., command: _Optional[bytes] = ...) -> None: ...

class RaftForwardedCommandReply(_message.Message):
    __slots__ = ("request_id", "refusal", "log_index", "log_term")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    REFUSAL_FIELD_NUMBER: _ClassVar[int]
    LOG_INDEX_FIELD_NUMBER: _ClassVar[int]
    LOG_TERM_FIELD_NUMBER: _ClassVar[int]
    request_id: int
    refusal: RaftRefusal
    log_index: int
    log_term: int
    def __init__(self, request_id: _Optional[int] = ..., refusal: _Optional[_Union[RaftRefusal, str]] = ..., log_index: _Optional[int] = ..., log_term: _Optional[int] = ...) -> None: ...

class RaftReadIndexRequest(_message.Message):
    __slots__ = ("request_id",)
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    request_id: int
    def __init__(self, request_id: _Optional[int] = ...) -> None: ...

class RaftReadIndexReply(_message.Message):
    __slots__ = ("request_id", "read_index")
    REQUEST_ID_FIELD_NUMBER: _ClassVar[int]
    READ_INDEX_FIELD_NUMBER: _ClassVar[int]
    request_id: int
    read_index: int
    def __init__(self, request_id: _Optional[int] = ..., read_index: _Optional[int] = ...) -> None: ...

class RaftSnapshot(_message.Message):
    __slots__ = ("previous", "last", "member_ids", "state", "configuration")
    PREVIOUS_FIELD_NUMBER: _ClassVar[int]
    LAST_FIELD_NUMBER: _ClassVar[int]
    MEMBER_IDS_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    CONFIGURATION_FIELD_NUMBER: _ClassVar[int]
    previous: RaftLogEntry
    last: RaftLogEntry
    member_ids: _containers.RepeatedScalarFieldContainer[str]
    state: bytes
    configuration: RaftConfiguration
    def __init__(self, previous: _Optional[_Union[RaftLogEntry, _Mapping]] = ..., last: _Optional[_Union[RaftLogEntry, _Mapping]] = ..., member_ids: _Optional[_Iterable[str]] = ..., state: _Optional[bytes] = ..., configuration: _Optional[_Union[RaftConfiguration, _Mapping]] = ...) -> None: ...
