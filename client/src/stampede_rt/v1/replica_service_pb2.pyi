from stampede_rt.v1 import channel_pb2 as _channel_pb2
from stampede_rt.v1 import channel_service_pb2 as _channel_service_pb2
from stampede_rt.v1 import group_pb2 as _group_pb2
from stampede_rt.v1 import item_pb2 as _item_pb2
from stampede_rt.v1 import subject_pb2 as _subject_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class FeedCause(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    FEED_CAUSE_UNSPECIFIED: _ClassVar[FeedCause]
    FEED_CAUSE_AGE: _ClassVar[FeedCause]
    FEED_CAUSE_COUNT: _ClassVar[FeedCause]
    FEED_CAUSE_BYTES: _ClassVar[FeedCause]
    FEED_CAUSE_CONSUMPTION: _ClassVar[FeedCause]
    FEED_CAUSE_ARCHIVE: _ClassVar[FeedCause]
FEED_CAUSE_UNSPECIFIED: FeedCause
FEED_CAUSE_AGE: FeedCause
FEED_CAUSE_COUNT: FeedCause
FEED_CAUSE_BYTES: FeedCause
FEED_CAUSE_CONSUMPTION: FeedCause
FEED_CAUSE_ARCHIVE: FeedCause

class FeedRequest(_message.Message):
    __slots__ = ("open", "credit_bytes", "sent_nanos", "subscriptions", "ready", "hold", "committed_epoch", "released", "held_next_seq", "item_next_seq")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    CREDIT_BYTES_FIELD_NUMBER: _ClassVar[int]
    SENT_NANOS_FIELD_NUMBER: _ClassVar[int]
    SUBSCRIPTIONS_FIELD_NUMBER: _ClassVar[int]
    READY_FIELD_NUMBER: _ClassVar[int]
    HOLD_FIELD_NUMBER: _ClassVar[int]
    COMMITTED_EPOCH_FIELD_NUMBER: _ClassVar[int]
    RELEASED_FIELD_NUMBER: _ClassVar[int]
    HELD_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    ITEM_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    open: FeedOpen
    credit_bytes: int
    sent_nanos: int
    subscriptions: int
    ready: bool
    hold: bool
    committed_epoch: int
    released: bool
    held_next_seq: int
    item_next_seq: int
    def __init__(self, open: _Optional[_Union[FeedOpen, _Mapping]] = ..., credit_bytes: _Optional[int] = ..., sent_nanos: _Optional[int] = ..., subscriptions: _Optional[int] = ..., ready: bool = ..., hold: bool = ..., committed_epoch: _Optional[int] = ..., released: bool = ..., held_next_seq: _Optional[int] = ..., item_next_seq: _Optional[int] = ...) -> None: ...

class FeedOpen(_message.Message):
    __slots__ = ("channel_id", "epoch", "host_id", "target", "place", "owner_facts", "move_id", "another_may_follow", "hand_over_when_idle", "takes_puts", "takes_items", "takes_runs")
    CHANNEL_ID_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    HOST_ID_FIELD_NUMBER: _ClassVar[int]
    TARGET_FIELD_NUMBER: _ClassVar[int]
    PLACE_FIELD_NUMBER: _ClassVar[int]
    OWNER_FACTS_FIELD_NUMBER: _ClassVar[int]
    MOVE_ID_FIELD_NUMBER: _ClassVar[int]
    ANOTHER_MAY_FOLLOW_FIELD_NUMBER: _ClassVar[int]
    HAND_OVER_WHEN_IDLE_FIELD_NUMBER: _ClassVar[int]
    TAKES_PUTS_FIELD_NUMBER: _ClassVar[int]
    TAKES_ITEMS_FIELD_NUMBER: _ClassVar[int]
    TAKES_RUNS_FIELD_NUMBER: _ClassVar[int]
    channel_id: bytes
    epoch: int
    host_id: bytes
    target: str
    place: FeedPlace
    owner_facts: bool
    move_id: bytes
    another_may_follow: bool
    hand_over_when_idle: bool
    takes_puts: bool
    takes_items: bool
    takes_runs: bool
    def __init__(self, channel_id: _Optional[bytes] = ..., epoch: _Optional[int] = ..., host_id: _Optional[bytes] = ..., target: _Optional[str] = ..., place: _Optional[_Union[FeedPlace, _Mapping]] = ..., owner_facts: bool = ..., move_id: _Optional[bytes] = ..., another_may_follow: bool = ..., hand_over_when_idle: bool = ..., takes_puts: bool = ..., takes_items: bool = ..., takes_runs: bool = ...) -> None: ...

class FeedPlace(_message.Message):
    __slots__ = ("incarnation", "next_seq", "floor_resets", "owner_until_unix_nano", "owner_epoch")
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    FLOOR_RESETS_FIELD_NUMBER: _ClassVar[int]
    OWNER_UNTIL_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    OWNER_EPOCH_FIELD_NUMBER: _ClassVar[int]
    incarnation: int
    next_seq: int
    floor_resets: int
    owner_until_unix_nano: int
    owner_epoch: int
    def __init__(self, incarnation: _Optional[int] = ..., next_seq: _Optional[int] = ..., floor_resets: _Optional[int] = ..., owner_until_unix_nano: _Optional[int] = ..., owner_epoch: _Optional[int] = ...) -> None: ...

class FeedResponse(_message.Message):
    __slots__ = ("opened", "state", "runs", "move_over", "item")
    OPENED_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    MOVE_OVER_FIELD_NUMBER: _ClassVar[int]
    ITEM_FIELD_NUMBER: _ClassVar[int]
    opened: FeedOpened
    state: FeedState
    runs: _containers.RepeatedCompositeFieldContainer[_item_pb2.DeliveredRun]
    move_over: bool
    item: FedItem
    def __init__(self, opened: _Optional[_Union[FeedOpened, _Mapping]] = ..., state: _Optional[_Union[FeedState, _Mapping]] = ..., runs: _Optional[_Iterable[_Union[_item_pb2.DeliveredRun, _Mapping]]] = ..., move_over: bool = ..., item: _Optional[_Union[FedItem, _Mapping]] = ...) -> None: ...

class FedItem(_message.Message):
    __slots__ = ("seq", "producer_id", "first_number", "time_unix_nano", "duration_nanos", "payload_length_bytes", "is_stamped", "judged_unix_nano", "floor_time_unix_nano", "floor_seq", "newest_collected_unix_nano", "collected_end_unix_nano", "run", "items")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    DURATION_NANOS_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_LENGTH_BYTES_FIELD_NUMBER: _ClassVar[int]
    IS_STAMPED_FIELD_NUMBER: _ClassVar[int]
    JUDGED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FLOOR_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FLOOR_SEQ_FIELD_NUMBER: _ClassVar[int]
    NEWEST_COLLECTED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_END_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    seq: int
    producer_id: int
    first_number: int
    time_unix_nano: int
    duration_nanos: int
    payload_length_bytes: int
    is_stamped: bool
    judged_unix_nano: int
    floor_time_unix_nano: int
    floor_seq: int
    newest_collected_unix_nano: int
    collected_end_unix_nano: int
    run: bytes
    items: int
    def __init__(self, seq: _Optional[int] = ..., producer_id: _Optional[int] = ..., first_number: _Optional[int] = ..., time_unix_nano: _Optional[int] = ..., duration_nanos: _Optional[int] = ..., payload_length_bytes: _Optional[int] = ..., is_stamped: bool = ..., judged_unix_nano: _Optional[int] = ..., floor_time_unix_nano: _Optional[int] = ..., floor_seq: _Optional[int] = ..., newest_collected_unix_nano: _Optional[int] = ..., collected_end_unix_nano: _Optional[int] = ..., run: _Optional[bytes] = ..., items: _Optional[int] = ...) -> None: ...

class FeedOpened(_message.Message):
    __slots__ = ("begins_anew", "lost_before_unix_nano", "lost_from_unix_nano", "former")
    BEGINS_ANEW_FIELD_NUMBER: _ClassVar[int]
    LOST_BEFORE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    LOST_FROM_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    FORMER_FIELD_NUMBER: _ClassVar[int]
    begins_anew: bool
    lost_before_unix_nano: int
    lost_from_unix_nano: int
    former: _containers.RepeatedCompositeFieldContainer[FeedFormerIncarnation]
    def __init__(self, begins_anew: bool = ..., lost_before_unix_nano: _Optional[int] = ..., lost_from_unix_nano: _Optional[int] = ..., former: _Optional[_Iterable[_Union[FeedFormerIncarnation, _Mapping]]] = ...) -> None: ...

class FeedFormerIncarnation(_message.Message):
    __slots__ = ("incarnation", "next_seq")
    INCARNATION_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    incarnation: int
    next_seq: int
    def __init__(self, incarnation: _Optional[int] = ..., next_seq: _Optional[int] = ...) -> None: ...

class FeedKey(_message.Message):
    __slots__ = ("time_unix_nano", "seq")
    TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    time_unix_nano: int
    seq: int
    def __init__(self, time_unix_nano: _Optional[int] = ..., seq: _Optional[int] = ...) -> None: ...

class FeedState(_message.Message):
    __slots__ = ("first_seq", "next_seq", "cleared", "collection", "advance_unix_nano", "channel", "heard_nanos", "staleness_nanos", "source_next_seq", "floors", "owner", "handoff", "put", "accepted", "advance_accepted_unix_nano")
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    CLEARED_FIELD_NUMBER: _ClassVar[int]
    COLLECTION_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CHANNEL_FIELD_NUMBER: _ClassVar[int]
    HEARD_NANOS_FIELD_NUMBER: _ClassVar[int]
    STALENESS_NANOS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_NEXT_SEQ_FIELD_NUMBER: _ClassVar[int]
    FLOORS_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    HANDOFF_FIELD_NUMBER: _ClassVar[int]
    PUT_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    ADVANCE_ACCEPTED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    first_seq: int
    next_seq: int
    cleared: FeedKey
    collection: FeedCollection
    advance_unix_nano: int
    channel: _channel_pb2.ChannelRecord
    heard_nanos: int
    staleness_nanos: int
    source_next_seq: int
    floors: _containers.RepeatedCompositeFieldContainer[_group_pb2.CutFloor]
    owner: OwnerFacts
    handoff: FeedHandoff
    put: FedPut
    accepted: FedAcceptances
    advance_accepted_unix_nano: int
    def __init__(self, first_seq: _Optional[int] = ..., next_seq: _Optional[int] = ..., cleared: _Optional[_Union[FeedKey, _Mapping]] = ..., collection: _Optional[_Union[FeedCollection, _Mapping]] = ..., advance_unix_nano: _Optional[int] = ..., channel: _Optional[_Union[_channel_pb2.ChannelRecord, _Mapping]] = ..., heard_nanos: _Optional[int] = ..., staleness_nanos: _Optional[int] = ..., source_next_seq: _Optional[int] = ..., floors: _Optional[_Iterable[_Union[_group_pb2.CutFloor, _Mapping]]] = ..., owner: _Optional[_Union[OwnerFacts, _Mapping]] = ..., handoff: _Optional[_Union[FeedHandoff, _Mapping]] = ..., put: _Optional[_Union[FedPut, _Mapping]] = ..., accepted: _Optional[_Union[FedAcceptances, _Mapping]] = ..., advance_accepted_unix_nano: _Optional[int] = ...) -> None: ...

class FedAcceptances(_message.Message):
    __slots__ = ("end_seqs", "accepted_unix_nano")
    END_SEQS_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    end_seqs: _containers.RepeatedScalarFieldContainer[int]
    accepted_unix_nano: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, end_seqs: _Optional[_Iterable[int]] = ..., accepted_unix_nano: _Optional[_Iterable[int]] = ...) -> None: ...

class FeedHandoff(_message.Message):
    __slots__ = ("host_time_unix_nano", "permit")
    HOST_TIME_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    PERMIT_FIELD_NUMBER: _ClassVar[int]
    host_time_unix_nano: int
    permit: bytes
    def __init__(self, host_time_unix_nano: _Optional[int] = ..., permit: _Optional[bytes] = ...) -> None: ...

class OwnerFacts(_message.Message):
    __slots__ = ("producers", "consumers", "counters", "late", "until_unix_nano")
    PRODUCERS_FIELD_NUMBER: _ClassVar[int]
    CONSUMERS_FIELD_NUMBER: _ClassVar[int]
    COUNTERS_FIELD_NUMBER: _ClassVar[int]
    LATE_FIELD_NUMBER: _ClassVar[int]
    UNTIL_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    producers: _containers.RepeatedCompositeFieldContainer[FedProducer]
    consumers: FedConsumers
    counters: _channel_pb2.ChannelCounters
    late: int
    until_unix_nano: int
    def __init__(self, producers: _Optional[_Iterable[_Union[FedProducer, _Mapping]]] = ..., consumers: _Optional[_Union[FedConsumers, _Mapping]] = ..., counters: _Optional[_Union[_channel_pb2.ChannelCounters, _Mapping]] = ..., late: _Optional[int] = ..., until_unix_nano: _Optional[int] = ...) -> None: ...

class FedProducer(_message.Message):
    __slots__ = ("producer_id", "owner", "runs")
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    RUNS_FIELD_NUMBER: _ClassVar[int]
    producer_id: int
    owner: str
    runs: _containers.RepeatedCompositeFieldContainer[FedRun]
    def __init__(self, producer_id: _Optional[int] = ..., owner: _Optional[str] = ..., runs: _Optional[_Iterable[_Union[FedRun, _Mapping]]] = ...) -> None: ...

class FedPut(_message.Message):
    __slots__ = ("producer_id", "owner", "first_number", "items", "first_seq", "stamped_unix_nano", "judged_ago_nanos", "until_unix_nano", "accepted", "accepted_bytes")
    PRODUCER_ID_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMPED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    JUDGED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    UNTIL_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_FIELD_NUMBER: _ClassVar[int]
    ACCEPTED_BYTES_FIELD_NUMBER: _ClassVar[int]
    producer_id: int
    owner: str
    first_number: int
    items: int
    first_seq: int
    stamped_unix_nano: int
    judged_ago_nanos: int
    until_unix_nano: int
    accepted: int
    accepted_bytes: int
    def __init__(self, producer_id: _Optional[int] = ..., owner: _Optional[str] = ..., first_number: _Optional[int] = ..., items: _Optional[int] = ..., first_seq: _Optional[int] = ..., stamped_unix_nano: _Optional[int] = ..., judged_ago_nanos: _Optional[int] = ..., until_unix_nano: _Optional[int] = ..., accepted: _Optional[int] = ..., accepted_bytes: _Optional[int] = ...) -> None: ...

class FedRun(_message.Message):
    __slots__ = ("first_number", "items", "judged_items", "parts", "rejections", "judged_ago_nanos")
    FIRST_NUMBER_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    JUDGED_ITEMS_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    REJECTIONS_FIELD_NUMBER: _ClassVar[int]
    JUDGED_AGO_NANOS_FIELD_NUMBER: _ClassVar[int]
    first_number: int
    items: int
    judged_items: int
    parts: _containers.RepeatedCompositeFieldContainer[FedRunPart]
    rejections: _containers.RepeatedCompositeFieldContainer[_channel_service_pb2.PutRejection]
    judged_ago_nanos: int
    def __init__(self, first_number: _Optional[int] = ..., items: _Optional[int] = ..., judged_items: _Optional[int] = ..., parts: _Optional[_Iterable[_Union[FedRunPart, _Mapping]]] = ..., rejections: _Optional[_Iterable[_Union[_channel_service_pb2.PutRejection, _Mapping]]] = ..., judged_ago_nanos: _Optional[int] = ...) -> None: ...

class FedRunPart(_message.Message):
    __slots__ = ("index", "first_seq", "items", "stamped_unix_nano")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    ITEMS_FIELD_NUMBER: _ClassVar[int]
    STAMPED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    index: int
    first_seq: int
    items: int
    stamped_unix_nano: int
    def __init__(self, index: _Optional[int] = ..., first_seq: _Optional[int] = ..., items: _Optional[int] = ..., stamped_unix_nano: _Optional[int] = ...) -> None: ...

class FedConsumers(_message.Message):
    __slots__ = ("begins", "places", "ends")
    BEGINS_FIELD_NUMBER: _ClassVar[int]
    PLACES_FIELD_NUMBER: _ClassVar[int]
    ENDS_FIELD_NUMBER: _ClassVar[int]
    begins: bool
    places: _containers.RepeatedCompositeFieldContainer[FedConsumer]
    ends: bool
    def __init__(self, begins: bool = ..., places: _Optional[_Iterable[_Union[FedConsumer, _Mapping]]] = ..., ends: bool = ...) -> None: ...

class FedConsumer(_message.Message):
    __slots__ = ("consumer_id", "lease_nanos", "consumed_below_seq", "consumed", "owner")
    CONSUMER_ID_FIELD_NUMBER: _ClassVar[int]
    LEASE_NANOS_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_BELOW_SEQ_FIELD_NUMBER: _ClassVar[int]
    CONSUMED_FIELD_NUMBER: _ClassVar[int]
    OWNER_FIELD_NUMBER: _ClassVar[int]
    consumer_id: int
    lease_nanos: int
    consumed_below_seq: int
    consumed: _containers.RepeatedCompositeFieldContainer[_subject_pb2.SeqRange]
    owner: str
    def __init__(self, consumer_id: _Optional[int] = ..., lease_nanos: _Optional[int] = ..., consumed_below_seq: _Optional[int] = ..., consumed: _Optional[_Iterable[_Union[_subject_pb2.SeqRange, _Mapping]]] = ..., owner: _Optional[str] = ...) -> None: ...

class FeedCollection(_message.Message):
    __slots__ = ("floor", "floor_resets", "last_cause", "newest_collected_unix_nano", "collected_end_unix_nano", "collected_by", "newest_consumed_unix_nano", "came_up_to_unix_nano")
    FLOOR_FIELD_NUMBER: _ClassVar[int]
    FLOOR_RESETS_FIELD_NUMBER: _ClassVar[int]
    LAST_CAUSE_FIELD_NUMBER: _ClassVar[int]
    NEWEST_COLLECTED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_END_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    COLLECTED_BY_FIELD_NUMBER: _ClassVar[int]
    NEWEST_CONSUMED_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    CAME_UP_TO_UNIX_NANO_FIELD_NUMBER: _ClassVar[int]
    floor: FeedKey
    floor_resets: int
    last_cause: FeedCause
    newest_collected_unix_nano: int
    collected_end_unix_nano: int
    collected_by: FeedCause
    newest_consumed_unix_nano: int
    came_up_to_unix_nano: int
    def __init__(self, floor: _Optional[_Union[FeedKey, _Mapping]] = ..., floor_resets: _Optional[int] = ..., last_cause: _Optional[_Union[FeedCause, str]] = ..., newest_collected_unix_nano: _Optional[int] = ..., collected_end_unix_nano: _Optional[int] = ..., collected_by: _Optional[_Union[FeedCause, str]] = ..., newest_consumed_unix_nano: _Optional[int] = ..., came_up_to_unix_nano: _Optional[int] = ...) -> None: ...
