from stampede_rt.v1 import error_pb2 as _error_pb2
from stampede_rt.v1 import group_pb2 as _group_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class ExchangeTimesRequest(_message.Message):
    __slots__ = ("hello", "update")
    HELLO_FIELD_NUMBER: _ClassVar[int]
    UPDATE_FIELD_NUMBER: _ClassVar[int]
    hello: ExchangeHello
    update: TimesUpdate
    def __init__(self, hello: _Optional[_Union[ExchangeHello, _Mapping]] = ..., update: _Optional[_Union[TimesUpdate, _Mapping]] = ...) -> None: ...

class ExchangeTimesResponse(_message.Message):
    __slots__ = ("hello", "update")
    HELLO_FIELD_NUMBER: _ClassVar[int]
    UPDATE_FIELD_NUMBER: _ClassVar[int]
    hello: ExchangeHello
    update: TimesUpdate
    def __init__(self, hello: _Optional[_Union[ExchangeHello, _Mapping]] = ..., update: _Optional[_Union[TimesUpdate, _Mapping]] = ...) -> None: ...

class ExchangeHello(_message.Message):
    __slots__ = ("cluster_id", "host_id", "boot_incarnation", "protocol_version")
    CLUSTER_ID_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    BOOT_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PROTOCOL_VERSION_FIELD_NUMBER: _ClassVar[int]
    cluster_id: str
    host_id: bytes
    boot_incarnation: int
    protocol_version: int
    def __init__(self, cluster_id: _Optional[str] = ..., host_id: _Optional[bytes] = ..., boot_incarnation: _Optional[int] = ..., protocol_version: _Optional[int] = ...) -> None: ...

class TimesUpdate(_message.Message):
    __slots__ = ("interest", "times", "floors")
    INTEREST_FIELD_NUMBER: _ClassVar[int]
    TIMES_FIELD_NUMBER: _ClassVar[int]
    FLOORS_FIELD_NUMBER: _ClassVar[int]
    interest: TimesInterest
    times: _containers.RepeatedCompositeFieldContainer[_group_pb2.ChannelTimes]
    floors: _containers.RepeatedCompositeFieldContainer[_group_pb2.CutFloor]
    def __init__(self, interest: _Optional[_Union[TimesInterest, _Mapping]] = ..., times: _Optional[_Iterable[_Union[_group_pb2.ChannelTimes, _Mapping]]] = ..., floors: _Optional[_Iterable[_Union[_group_pb2.CutFloor, _Mapping]]] = ...) -> None: ...

class TimesInterest(_message.Message):
    __slots__ = ("channel_ids",)
    CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class GetCutRequest(_message.Message):
    __slots__ = ("group_id", "cut_floor_unix_nano", "wait_nanos")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    CUT_FLOOR_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    cut_floor_unix_nano: int
    wait_nanos: int
    def __init__(self, group_id: _Optional[bytes] = ..., cut_floor_unix_nano: _Optional[int] = ..., wait_nanos: _Optional[int] = ...) -> None: ...

class GetCutResponse(_message.Message):
    __slots__ = ("floor", "stalled", "waiting_on_channel_ids")
    FLOOR_FIELD_NUMBER: _ClassVar[int]
    STALLED_FIELD_NUMBER: _ClassVar[int]
    WAITING_ON_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    floor: _group_pb2.CutFloor
    stalled: bool
    waiting_on_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, floor: _Optional[_Union[_group_pb2.CutFloor, _Mapping]] = ..., stalled: bool = ..., waiting_on_channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class SubscribeCutsRequest(_message.Message):
    __slots__ = ("open", "boundary", "credit")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    BOUNDARY_FIELD_NUMBER: _ClassVar[int]
    CREDIT_FIELD_NUMBER: _ClassVar[int]
    open: SubscribeCutsOpen
    boundary: CutBoundary
    credit: int
    def __init__(self, open: _Optional[_Union[SubscribeCutsOpen, _Mapping]] = ..., boundary: _Optional[_Union[CutBoundary, _Mapping]] = ..., credit: _Optional[int] = ...) -> None: ...

class SubscribeCutsOpen(_message.Message):
    __slots__ = ("group_id", "decides", "max_wait_nanos", "after", "without_payloads", "spec_version", "lateness_nanos")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    DECIDES_FIELD_NUMBER: _ClassVar[int]
    MAX_WAIT_NANOS_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_PAYLOADS_FIELD_NUMBER: _ClassVar[int]
    SPEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    LATENESS_NANOS_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    decides: bool
    max_wait_nanos: int
    after: CutCursor
    without_payloads: bool
    spec_version: int
    lateness_nanos: int
    def __init__(self, group_id: _Optional[bytes] = ..., decides: bool = ..., max_wait_nanos: _Optional[int] = ..., after: _Optional[_Union[CutCursor, _Mapping]] = ..., without_payloads: bool = ..., spec_version: _Optional[int] = ..., lateness_nanos: _Optional[int] = ...) -> None: ...

class CutCursor(_message.Message):
    __slots__ = ("incarnation", "cut_unix_nano", "channels")
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CHANNELS_FIELD_NUMBER: _ClassVar[int]
    incarnation: int
    cut_unix_nano: int
    channels: _containers.RepeatedCompositeFieldContainer[ChannelCursor]
    def __init__(self, incarnation: _Optional[int] = ..., cut_unix_nano: _Optional[int] = ..., channels: _Optional[_Iterable[_Union[ChannelCursor, _Mapping]]] = ...) -> None: ...

class ChannelCursor(_message.Message):
    __slots__ = ("channel_id", "incarnation", "next_seq")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    incarnation: int
    next_seq: int
    def __init__(self, channel_id: _Optional[bytes] = ..., incarnation: _Optional[int] = ..., next_seq: _Optional[int] = ...) -> None: ...

class CutBoundary(_message.Message):
    __slots__ = ("cut_unix_nano", "incarnation", "incomplete_channel_ids")
    CUT_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    INCOMPLETE_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    cut_unix_nano: int
    incarnation: int
    incomplete_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, cut_unix_nano: _Optional[int] = ..., incarnation: _Optional[int] = ..., incomplete_channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class SubscribeCutsResponse(_message.Message):
    __slots__ = ("opened", "parts", "boundary")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    BOUNDARY_FIELD_NUMBER: _ClassVar[int]
    opened: CutCursor
    parts: _containers.RepeatedCompositeFieldContainer[CutPart]
    boundary: CutBoundary
    def __init__(self, opened: _Optional[_Union[CutCursor, _Mapping]] = ..., parts: _Optional[_Iterable[_Union[CutPart, _Mapping]]] = ..., boundary: _Optional[_Union[CutBoundary, _Mapping]] = ...) -> None: ...

class CutPart(_message.Message):
    __slots__ = ("channel_id", "runs", "late_runs", "loss", "cursor")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    LATE_RUNS_FIELD_NUMBER: _ClassVar[int]
    LOSS_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    runs: _containers.RepeatedCompositeFieldContainer[_item_pb2.DeliveredRun]
    late_runs: _containers.RepeatedCompositeFieldContainer[_item_pb2.DeliveredRun]
    loss: CutLoss
    cursor: ChannelCursor
    def __init__(self, channel_id: _Optional[bytes] = ..., runs: _Optional[_Iterable[_Union[_item_pb2.DeliveredRun, _Mapping]]] = ..., late_runs: _Optional[_Iterable[_Union[_item_pb2.DeliveredRun, _Mapping]]] = ..., loss: _Optional[_Union[CutLoss, _Mapping]] = ..., cursor: _Optional[_Union[ChannelCursor, _Mapping]] = ...) -> None: ...

class CutLoss(_message.Message):
    __slots__ = ("before_unix_nano", "items", "reason", "detail")
    BEFORE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    REASON_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    before_unix_nano: int
    items: int
    reason: _error_pb2.AbsenceReason
    detail: str
    def __init__(self, before_unix_nano: _Optional[int] = ..., items: _Optional[int] = ..., reason: _Optional[_Union[_error_pb2.AbsenceReason, str]] = ..., detail: _Optional[str] = ...) -> None: ...

class SubscribeMatchesRequest(_message.Message):
    __slots__ = ("open", "credit_bytes")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    CREDIT_BYTES_FIELD_NUMBER: _ClassVar[int]
    open: SubscribeMatchesOpen
    credit_bytes: int
    def __init__(self, open: _Optional[_Union[SubscribeMatchesOpen, _Mapping]] = ..., credit_bytes: _Optional[int] = ...) -> None: ...

class SubscribeMatchesOpen(_message.Message):
    __slots__ = ("group_id", "per_channel_id", "epoch", "tolerance_nanos", "after", "without_payloads", "unique", "lateness_nanos")
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    PER_CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_NANOS_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    WITHOUT_PAYLOADS_FIELD_NUMBER: _ClassVar[int]
    UNIQUE_FIELD_NUMBER: _ClassVar[int]
    LATENESS_NANOS_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    per_channel_id: bytes
    epoch: int
    tolerance_nanos: int
    after: MatchCursor
    without_payloads: bool
    unique: bool
    lateness_nanos: int
    def __init__(self, group_id: _Optional[bytes] = ..., per_channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., tolerance_nanos: _Optional[int] = ..., after: _Optional[_Union[MatchCursor, _Mapping]] = ..., without_payloads: bool = ..., unique: bool = ..., lateness_nanos: _Optional[int] = ...) -> None: ...

class MatchCursor(_message.Message):
    __slots__ = ("after", "next_seq", "group_incarnation", "partners")
    AFTER_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    GROUP_INCARNATION_FIELD_NUMBER: _ClassVar[int]
    PARTNERS_FIELD_NUMBER: _ClassVar[int]
    after: _item_pb2.ItemPosition
    next_seq: int
    group_incarnation: int
    partners: _containers.RepeatedCompositeFieldContainer[MatchedItem]
    def __init__(self, after: _Optional[_Union[_item_pb2.ItemPosition, _Mapping]] = ..., next_seq: _Optional[int] = ..., group_incarnation: _Optional[int] = ..., partners: _Optional[_Iterable[_Union[MatchedItem, _Mapping]]] = ...) -> None: ...

class SubscribeMatchesResponse(_message.Message):
    __slots__ = ("matches", "unmatched", "dropped", "cursor")
    MATCHES_FIELD_NUMBER: _ClassVar[int]
    UNMATCHED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    matches: _containers.RepeatedCompositeFieldContainer[ItemMatch]
    unmatched: int
    dropped: int
    cursor: MatchCursor
    def __init__(self, matches: _Optional[_Iterable[_Union[ItemMatch, _Mapping]]] = ..., unmatched: _Optional[int] = ..., dropped: _Optional[int] = ..., cursor: _Optional[_Union[MatchCursor, _Mapping]] = ...) -> None: ...

class ItemMatch(_message.Message):
    __slots__ = ("item", "matched", "unmatched_channel_ids")
    ITEM_FIELD_NUMBER: _ClassVar[int]
    MATCHED_FIELD_NUMBER: _ClassVar[int]
    UNMATCHED_CHANNEL_IDS_FIELD_NUMBER: _ClassVar[int]
    item: _item_pb2.DeliveredRun
    matched: _containers.RepeatedCompositeFieldContainer[MatchedItem]
    unmatched_channel_ids: _containers.RepeatedScalarFieldContainer[bytes]
    def __init__(self, item: _Optional[_Union[_item_pb2.DeliveredRun, _Mapping]] = ..., matched: _Optional[_Iterable[_Union[MatchedItem, _Mapping]]] = ..., unmatched_channel_ids: _Optional[_Iterable[bytes]] = ...) -> None: ...

class MatchedItem(_message.Message):
    __slots__ = ("channel_id", "position", "item")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    ITEM_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    position: _item_pb2.ItemPosition
    item: _item_pb2.DeliveredRun
    def __init__(self, channel_id: _Optional[bytes] = ..., position: _Optional[_Union[_item_pb2.ItemPosition, _Mapping]] = ..., item: _Optional[_Union[_item_pb2.DeliveredRun, _Mapping]] = ...) -> None: ...

class GetGroupStatusRequest(_message.Message):
    __slots__ = ("group_id",)
    GROUP_ID_FIELD_NUMBER: _ClassVar[int]
    group_id: bytes
    def __init__(self, group_id: _Optional[bytes] = ...) -> None: ...

class GetGroupStatusResponse(_message.Message):
    __slots__ = ("status",)
    STATUS_FIELD_NUMBER: _ClassVar[int]
    status: _group_pb2.GroupStatus
    def __init__(self, status: _Optional[_Union[_group_pb2.GroupStatus, _Mapping]] = ...) -> None: ...
