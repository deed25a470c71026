"""Converts the parts of feeds to and from protobuf (`replica_service.proto`)."""

from __future__ import annotations

from array import array
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import item_pb2
from stampede_rt.v1 import replica_service_pb2 as pb
from stampede_rt.wire.plain_runs import read_sealed_run
from stampede_rt.wire.run_slices import SealedColumns, sealed_columns
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.copies.owner_messages import owner_of, owner_to, put_of, put_to
from stampede_rt_channel_host.core.channel import (
    FIRST_KEY,
    FORMER_MAX,
    AcceptedAdvance,
    AcceptedRows,
    CollectionFacts,
    ColumnRun,
    FeedPart,
    FeedPlace,
    FormerIncarnation,
    GrowingCounts,
    ItemKey,
    Losses,
    NewItem,
    OwnerPart,
    Run,
    SingleItemRun,
    make_run,
)
from stampede_rt_channel_host.core.records import RecordedChannel

_CAUSES = {
    "age": pb.FEED_CAUSE_AGE,
    "count": pb.FEED_CAUSE_COUNT,
    "bytes": pb.FEED_CAUSE_BYTES,
    "consumption": pb.FEED_CAUSE_CONSUMPTION,
    "archive": pb.FEED_CAUSE_ARCHIVE,
}
_FROM_CAUSES: dict[int, str] = {number: cause for cause, number in _CAUSES.items()}


def record_in(state: pb.FeedState, own: RecordedChannel) -> RecordedChannel:
    """The record that the source of the channel `own` has sent. A source must not change other channels of this host.

    Raises InvalidArgument if it is the record of another channel.
    """
    if state.channel.channel_id != own.channel_id:
        raise InvalidArgument(f"the source of channel {own.name} sent the record of another channel")
    return recorded_channel(state.channel)


def place_to(place: FeedPlace, epoch: int) -> pb.FeedPlace:
    """The place of a copy, as a message. `epoch`: the epoch of the owner, as the copy knows it."""
    return pb.FeedPlace(
        incarnation=place.incarnation,
        next_seq=place.next_seq,
        floor_resets=place.floor_resets,
        owner_until_unix_nano=place.owner_until,
        owner_epoch=epoch,
    )


def place_of(message: pb.FeedPlace, epoch: int) -> FeedPlace:
    """The place of a copy, from a message to the source at `epoch`. Raises InvalidArgument for a place without a seq.

    Leaves out a reading of the clock of an earlier owner.
    """
    if not message.next_seq:
        raise InvalidArgument("the feed's place has no next_seq; leave the place out for a copy that holds nothing")
    knows = message.HasField("owner_until_unix_nano") and message.owner_epoch == epoch
    until = message.owner_until_unix_nano if knows else None
    return FeedPlace(message.incarnation, message.next_seq, message.floor_resets, until)


def opened_to(losses: Losses, *, begins_anew: bool) -> pb.FeedOpened:
    """The beginning of a feed, as a message."""
    former = [pb.FeedFormerIncarnation(incarnation=one.incarnation, next_seq=one.next_seq) for one in losses.former]
    return pb.FeedOpened(
        begins_anew=begins_anew,
        lost_before_unix_nano=losses.before,
        lost_from_unix_nano=losses.since,
        former=former,
    )


def losses_of(message: pb.FeedOpened) -> Losses:
    """The losses of the channel that is fed."""
    return Losses(
        message.lost_before_unix_nano if message.HasField("lost_before_unix_nano") else None,
        message.lost_from_unix_nano if message.HasField("lost_from_unix_nano") else None,
        tuple(FormerIncarnation(one.incarnation, one.next_seq) for one in message.former[-FORMER_MAX:]),
    )


def state_to(part: FeedPart, now: int) -> pb.FeedState:
    """The facts of a part, without its items and without the facts about the source itself. `now`: its clock."""
    owner_part = part.owner_part
    is_put = owner_part is not None and isinstance(owner_part.counters, GrowingCounts)
    return pb.FeedState(
        first_seq=part.first_seq,
        next_seq=part.next_seq,
        cleared=None if part.cleared is None else _key_to(part.cleared),
        collection=None if part.collection is None else _collection_to(part.collection),
        advance_unix_nano=part.advance,
        owner=None if owner_part is None or is_put else owner_to(owner_part, now),
        put=None if owner_part is None or not is_put else put_to(owner_part, now),
        accepted=None if part.accepted is None else _accepted_to(part.accepted),
        advance_accepted_unix_nano=None if part.advanced is None else part.advanced.accepted,
    )


def _accepted_to(rows: AcceptedRows) -> pb.FedAcceptances:
    return pb.FedAcceptances(end_seqs=rows.ends, accepted_unix_nano=rows.instants)


def accepted_of(state: pb.FeedState) -> AcceptedRows | None:
    """When the owner accepted the items; None: the source does not know. Raises InvalidArgument for unequal lists."""
    if not state.HasField("accepted"):
        return None
    ends, instants = (*state.accepted.end_seqs,), (*state.accepted.accepted_unix_nano,)
    if len(ends) != len(instants) or max(ends, default=0) > state.next_seq:
        raise InvalidArgument("the feed has instants without items; install the same release on both hosts")
    return AcceptedRows(ends, instants)


def advanced_of(state: pb.FeedState) -> AcceptedAdvance | None:
    """The advance, and when the owner accepted it; None: there is no new advance, or the source does not know."""
    if not (state.HasField("advance_unix_nano") and state.HasField("advance_accepted_unix_nano")):
        return None
    return AcceptedAdvance(state.advance_accepted_unix_nano, state.advance_unix_nano)


def cleared_of(state: pb.FeedState) -> ItemKey | None:
    """The key below which the copy drops its items before it takes the part; None: it drops none."""
    return _key_of(state.cleared) if state.HasField("cleared") else None


def collection_of(state: pb.FeedState) -> CollectionFacts | None:
    """The items that retention has collected; None: as before. Raises InvalidArgument for an unknown cause."""
    if not state.HasField("collection"):
        return None
    message = state.collection
    return CollectionFacts(
        _key_of(message.floor) if message.HasField("floor") else FIRST_KEY,
        message.floor_resets,
        _cause_of(message.last_cause),
        message.newest_collected_unix_nano if message.HasField("newest_collected_unix_nano") else None,
        message.collected_end_unix_nano if message.HasField("collected_end_unix_nano") else None,
        _cause_of(message.collected_by),
        message.newest_consumed_unix_nano if message.HasField("newest_consumed_unix_nano") else None,
        message.came_up_to_unix_nano if message.HasField("came_up_to_unix_nano") else None,
    )


def advance_of(state: pb.FeedState) -> int | None:
    """The advance; None: as before."""
    return state.advance_unix_nano if state.HasField("advance_unix_nano") else None


def facts_after_runs(state: pb.FeedState) -> dict[str, Any]:
    """The arguments of `FedChannel.apply` that the copy applies after the runs of a part. Raises InvalidArgument."""
    return {
        "collection": collection_of(state),
        "advance": advance_of(state),
        "accepted": accepted_of(state),
        "advanced": advanced_of(state),
    }


def facts_of(state: pb.FeedState, now: int) -> OwnerPart | None:
    """The facts that only the owner knows; None: as before. `now`: the clock of the copy's host."""
    if state.HasField("put"):
        return put_of(state.put, now)
    return owner_of(state.owner, now) if state.HasField("owner") else None


def run_of(body: bytes) -> Run:
    """The run of a feed, as the copy stores it. Raises InvalidArgument if the source sends no valid run."""
    if (one := read_sealed_run(body)) is not None:
        seq, (time, duration, length) = one
        assert time is not None, "a sealed run has times"
        return make_run(seq, (time,), None if duration is None else (duration,), (length,), body)
    found = sealed_columns(body) or _parsed(body)
    items = len(found.lengths)
    if not items or len(found.times) != items or (found.durations and len(found.durations) != items):
        raise InvalidArgument("the feed has a run whose columns disagree; install the same release on both hosts")
    if items == 1:
        return make_run(*found, body)
    run = ColumnRun(*found, body)
    run.whole_bytes = sum(found.lengths)
    return run


def run_of_item(item: NewItem) -> Run:
    """The run that the copy stores for a part of a feed that was sent ahead. Raises InvalidArgument as `run_of`."""
    if item.items == 1:
        return SingleItemRun(item.seq, item.time, item.duration, item.length, item.body)
    run = run_of(bytes(item.body))
    if (run.first_seq, len(run), run.payload_bytes(0, len(run))) != (item.seq, item.items, item.length):
        raise InvalidArgument("the feed has a run that disagrees with its items; install one release on both hosts")
    return run


def _parsed(body: bytes) -> SealedColumns:
    run = item_pb2.ItemRun.FromString(body)
    times, durations = array("q", run.time_unix_nano), array("q", run.duration_nanos)
    return SealedColumns(run.first_seq, times, durations or None, array("I", run.payload_length_bytes))


def _collection_to(collection: CollectionFacts) -> pb.FeedCollection:
    return pb.FeedCollection(
        floor=None if collection.floor == FIRST_KEY else _key_to(collection.floor),
        floor_resets=collection.floor_resets,
        last_cause=_CAUSES[collection.last_cause],
        newest_collected_unix_nano=collection.newest_collected,
        collected_end_unix_nano=_clamped(collection.collected_end),
        collected_by=_CAUSES[collection.collected_by],
        newest_consumed_unix_nano=collection.newest_consumed,
        came_up_to_unix_nano=collection.frontier_max,
    )


def _cause_of(number: int) -> str:
    if number not in _FROM_CAUSES:
        raise InvalidArgument(f"the feed names cause {number}; install the same release on both hosts")
    return _FROM_CAUSES[number]


def _key_to(key: ItemKey) -> pb.FeedKey:
    return pb.FeedKey(time_unix_nano=key[0], seq=key[1])


def _key_of(message: pb.FeedKey) -> ItemKey:
    return message.time_unix_nano, message.seq


def _clamped(instant: int | None) -> int | None:
    """The instant, at most the greatest int64: a span may end later."""
    return None if instant is None else min(instant, 2**63 - 1)
