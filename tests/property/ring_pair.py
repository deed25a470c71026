"""A channel of the core, the oracle, and a ring of the channel. Each answer of the ring must be the oracle's."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

from stampede_rt.ring.layout import RingSize
from stampede_rt.ring.newest import FoundNewest, find_newest
from stampede_rt.ring.ring_view import RingView
from stampede_rt.ring.selecting import Columns, RunPiece, select
from stampede_rt.ring.successors import FoundNext, find_next
from stampede_rt.values.model import Policy
from stampede_rt.values.reading import ReadQuery
from stampede_rt_channel_host.core.channel import AllCursor, Offer, Query, Slice
from stampede_rt_channel_host.core.ring_writer import ClockReading, RingRun, RingWriter
from tests.oracle import Item, OracleReader, OracleSubscription
from tests.property.channel_pair import ChannelPair, ends_as_read, facts

SIZES = (RingSize(64, 65536), RingSize(4, 4096), RingSize(8, 2048))


def columns_of(body: bytes) -> Columns:
    times, durations, _ = pickle.loads(body)
    return times, durations


def _body(part: Slice) -> bytes:
    durations = None if part.run.durations is None else list(part.run.durations[part.lo : part.hi])
    return pickle.dumps(([*part.run.times[part.lo : part.hi]], durations, [*part.run.lengths[part.lo : part.hi]]))


def _items_in(piece: RunPiece, first_seq: int) -> list[Item]:
    times, durations, lengths = pickle.loads(piece.body)
    kept = [None if one < 0 else one for one in durations or (-1,) * len(times)]
    return [Item(times[at], first_seq + at, kept[at], lengths[at]) for at in range(piece.lo, piece.hi)]


@dataclass
class RingPair(ChannelPair):
    """A ChannelPair with a ring. `answered` counts the reads that the ring answered."""

    size: RingSize = SIZES[0]
    answered: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("read", "newest", "next"), 0))
    view: RingView | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.seqs: dict[bytes, list[int]] = {}
        self.make_ring()

    def make_ring(self) -> None:
        """Make a new ring with the newest items. A channel with consumers gets none."""
        self.view = None
        if self.core.policy.consumers or self.core.policy.max_age_unconsumed_nanos:
            return
        memory = memoryview(bytearray(self.size.whole_bytes))
        self._writer = RingWriter(memory, self.size, 7, self.core.newest)
        self._writer.set_fence(2**62)
        self._next_seq = self.core.next_seq
        newest: list[Slice] = []
        for part in islice(self.core.newest_slices(), 3):
            if newest and part.end_seq != newest[-1].first_seq:
                break
            newest.append(part)
        for part in reversed(newest):
            self._append(part)
        self._publish()
        self.view = RingView(memory.toreadonly())

    def _append(self, part: Slice) -> None:
        duration = -1 if part.run.durations is None else part.run.durations[part.lo]
        run = RingRun(part.first_seq, part.items, part.first_time, part.last_time, _body(part), duration)
        assert self._writer.takes(len(run.body))
        self._writer.append(run)

    def _publish(self) -> None:
        self._writer.publish(self.core.ring_facts(), ClockReading(0, self.clock, 0))

    def follow(self) -> None:
        """Write the change to the ring, as the host does after each change."""
        if self.view is not None:
            for part in self.core.accepted_from(self._next_seq):
                self._append(part)
            self._next_seq = self.core.next_seq
            self._publish()

    def put(self, offer: Offer) -> None:
        super().put(offer)
        self.follow()

    def advance(self, instant: int) -> None:
        super().advance(instant)
        self.follow()

    def configure(self, policy: Policy) -> None:
        super().configure(policy)
        self.make_ring()

    def collect(self, entries_max: int) -> None:
        super().collect(entries_max)
        self.follow()

    def read(self, query: Query) -> None:
        """Read from the ring first, because a read of the core outdates items."""
        if self.view is not None:
            self._read_ring(self.view, query)
            self._newest_of_ring(self.view)
        super().read(query)

    def _read_ring(self, view: RingView, query: Query) -> None:
        ring_query = ReadQuery(query.interval, query.match, query.limit, query.newest_first, complete=query.complete)
        known = view.facts()
        assert known is not None
        picked = select(view, known, ring_query, self.clock, columns_of)
        if picked is None:
            return
        self.answered["read"] += 1
        plain = replace(query, after=None, newer_than=None)
        reader = OracleReader(self.oracle, self.clock)
        expected = reader.read(plain, reader.resolve(plain))
        items = [item for piece in picked.pieces for item in _items_in(piece, 0)]
        assert [one[::2] for one in facts(items)] == [one[::2] for one in facts(expected.items)]
        assert ends_as_read(items, picked.next_time, self.oracle.overlap) == expected.ends
        assert (picked.interval, picked.complete, picked.truncated, picked.more) == (
            expected.interval, expected.complete, expected.truncated, expected.more,
        )  # fmt: skip
        assert expected.reason is None

    def _newest_of_ring(self, view: RingView) -> None:
        known = view.facts()
        assert known is not None
        for after in (None, (self.clock, 0)):
            found = find_newest(view, known, after)
            self.oracle.age(self.clock)
            newest = self.oracle.held[-1] if self.oracle.held else None
            if isinstance(found, FoundNewest):
                self.answered["newest"] += 1
                assert newest is not None
                assert (found.slot.last_time, found.slot.seq + found.slot.items - 1) == (newest.time, newest.seq)
                assert found.next_seq == len(self.oracle.log) + 1
            elif not found:
                assert newest is None or (after is not None and (newest.time, newest.seq) <= after)

    def _deliver(self, cursor: AllCursor, subscription: OracleSubscription, limit_bytes: int) -> None:
        saved = cursor.saved(7)
        if self.view is not None and saved.low is None:
            self._next_of_ring(self.view, saved.next_seq, subscription)
        super()._deliver(cursor, subscription, limit_bytes)

    def _next_of_ring(self, view: RingView, seq: int, subscription: OracleSubscription) -> None:
        known = view.facts()
        assert known is not None
        found = find_next(view, known, seq, -1, self.clock, columns_of)
        self.oracle.age(self.clock)
        if not found:
            assert seq == len(self.oracle.log) + 1
        elif isinstance(found, FoundNext):
            self.answered["next"] += 1
            items = _items_in(found.piece, found.end_seq - found.piece.hi)
            assert items[0].seq == seq
            assert facts(items) == facts([self.oracle.log[item.seq] for item in items])
            assert all(subscription.is_held(item.seq) for item in items)
            ends: Sequence[Any] = [self.oracle.end(self.oracle.log[item.seq]) for item in items]
            assert ends_as_read(items, found.next_time, self.oracle.overlap) == ends
