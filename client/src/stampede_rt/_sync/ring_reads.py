# Generated from ../_async by tools/generate.py; do not edit.
"""Reads of one channel from its ring."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from google.protobuf.message import DecodeError

from stampede_rt._sync.channel_state import ChannelState
from stampede_rt._sync.session import Session
from stampede_rt.ring.facts import host_now
from stampede_rt.ring.layout import CHANGES_WORD
from stampede_rt.ring.newest import FoundNewest, find_newest
from stampede_rt.ring.ring_view import Slot
from stampede_rt.ring.selecting import Columns, RingAnswer, RunPiece, select
from stampede_rt.transports.concurrency_sync import monotonic_s
from stampede_rt.transports.ring_mapping import RingMapping, boottime_nanos
from stampede_rt.v1 import item_pb2
from stampede_rt.values.answers import Items
from stampede_rt.values.columns import span_end
from stampede_rt.values.model import Item
from stampede_rt.values.reading import ReadQuery
from stampede_rt.wire.delivered import malformed
from stampede_rt.wire.reads import check_item
from stampede_rt.wire.run_slices import RunSlicer

_DAMAGES = (DecodeError, struct.error, IndexError, KeyError, ValueError, OverflowError)


class HostMustAnswer:
    """The result of a read that only the host can answer."""


ASK_HOST = HostMustAnswer()


def read_newest(
    session: Session, state: ChannelState, after: Item | int | None, deadline_s: float | None
) -> Item | HostMustAnswer | None:
    """Return the newest item, see `Reader.newest`. Waits until `deadline_s`; None: without a limit; 0: not at all."""
    mapping = session.rings.find(state)
    if mapping is None:
        return ASK_HOST
    session.check()
    if after is None and (unchanged := mapping.unchanged_newest()) is not None and mapping.is_open(boottime_nanos()):
        return newest_item(state, mapping, unchanged)
    position: tuple[int, int] | None = None
    if isinstance(after, Item):
        check_item(after)
        if after.incarnation not in (0, mapping.view.incarnation):
            return ASK_HOST
        position = after.time, after.seq
    elif after is not None:
        position = after, 2**64
    while True:
        changes = mapping.view.words[CHANGES_WORD]
        facts = mapping.view.facts()
        found = True if facts is None else find_newest(mapping.view, facts, position)
        if found is True or not mapping.is_open(boottime_nanos()):
            return ASK_HOST
        if found is not False:
            if after is None and facts is not None:
                mapping.keep_newest(facts, found)
            return newest_item(state, mapping, found)
        left_s = float("inf") if deadline_s is None else deadline_s - monotonic_s()
        if left_s <= 0:
            return None
        if not session.rings.waits.wait(mapping, changes, left_s):
            return ASK_HOST
        session.check()


def newest_item(state: ChannelState, mapping: RingMapping, found: FoundNewest) -> Item:
    """Return the item that `find_newest` has found. Raises StampedeError for a damaged run."""
    slot, body = found.slot, found.body
    if not found.is_plain:
        piece = RunPiece(body, slot.items - 1, slot.items, slot.items == 1)
        return items_of(state, mapping, [piece], None, backwards=False)[0]
    return plain_item(state, mapping, slot, body, None)


def plain_item(state: ChannelState, mapping: RingMapping, slot: Slot, payload: bytes, next_time: int | None) -> Item:
    """Return the item of a plain slot. `next_time`: the time of the bucket after the item; None: the item is the newest
    one."""
    policy, time, duration = state.info.policy, slot.first_time, slot.duration
    fields: tuple[Any, ...] = (
        time,
        span_end(time, duration, next_time, policy.overlap_nanos or 0),
        None if duration < 0 else duration,
        slot.seq,
        payload,
        {},
        policy.content_type or "",
        len(payload),
        mapping.view.incarnation,
    )
    return Item._make(fields) if state.coding is None else state.coding.item(fields)


def read_interval(session: Session, state: ChannelState, query: ReadQuery) -> Items | HostMustAnswer:
    """Return the answer to a read (see `Reader.get`), or ASK_HOST. It never waits for items."""
    mapping = session.rings.find(state)
    if mapping is None:
        return ASK_HOST
    session.check()
    facts = mapping.view.facts()
    if facts is None:
        return ASK_HOST
    picked = select(mapping.view, facts, query, host_now(facts, boottime_nanos()), columns_of)
    if picked is None or not mapping.is_open(boottime_nanos()):
        return ASK_HOST
    return _answer(state, mapping, query, picked)


def _answer(state: ChannelState, mapping: RingMapping, query: ReadQuery, picked: RingAnswer) -> Items:
    return Items(
        items_of(state, mapping, picked.pieces, picked.next_time, backwards=query.newest_first),
        interval=picked.interval,
        complete=picked.complete,
        truncated=picked.truncated,
        more=picked.more,
        reason=None,
        incarnation=mapping.view.incarnation,
    )


def columns_of(body: bytes) -> Columns:
    """Return the times and the durations of an encoded run. Raises StampedeError if it is damaged."""
    try:
        run = item_pb2.ItemRun.FromString(body)
    except DecodeError as error:
        raise malformed("no valid message in shared memory") from error
    return run.time_unix_nano, run.duration_nanos or None


def items_of(
    state: ChannelState, mapping: RingMapping, pieces: Sequence[RunPiece], next_time: int | None, *, backwards: bool
) -> Sequence[Item]:
    """Return the items of runs that follow each other in time. Raises StampedeError for a damaged run."""
    delivered = []
    try:
        for piece in pieces:
            body = piece.body if piece.is_whole else RunSlicer(piece.body).cut(piece.lo, piece.hi)
            delivered.append(item_pb2.DeliveredRun(run=item_pb2.ItemRun.FromString(body)))
    except _DAMAGES as error:
        raise malformed(f"a defect in shared memory ({error})") from error
    if next_time is not None:
        delivered[-1].next_time_unix_nano = next_time
    decoder = state.decoder(mapping.view.incarnation, payloads=True)
    return decoder.decode(delivered, backwards=backwards)
