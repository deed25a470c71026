"""Follows a channel in its ring, for a subscription that has reached the newest items."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt._async.channel_state import ChannelState
from stampede_rt._async.ring_reads import ASK_HOST, HostMustAnswer, columns_of, items_of, newest_item, plain_item
from stampede_rt.pacing.crediting import WINDOW_AGE_S
from stampede_rt.ring.facts import host_now
from stampede_rt.ring.layout import CHANGES_WORD
from stampede_rt.ring.newest import find_newest
from stampede_rt.ring.successors import FoundNext, find_next
from stampede_rt.transports.concurrency_async import monotonic_s
from stampede_rt.transports.ring_mapping import WAIT_S_MAX, RingMapping, boottime_nanos
from stampede_rt.transports.ring_waiting_async import RingWaits
from stampede_rt.v1 import channel_service_pb2 as channel_pb
from stampede_rt.values.model import Item
from stampede_rt.values.seq_starts import given_between
from stampede_rt.wire.long_answers import LongRun

STEP_BYTES_MAX = 2**20
"""A subscription takes slots until it has this many bytes. The program then takes the items from memory of its own."""
SLOTS_MAX = 64
BATCH_SLOTS_MAX = 512  # the program takes these items immediately, so they do not become old
_SEQ_MAX = 2**63 - 1


class RingFollower:
    """The position of one subscription in a ring.

    Create it with the cursor of the subscription's stream. If it `fits`, end that stream.
    """

    def __init__(
        self,
        state: ChannelState,
        mapping: RingMapping,
        cursor: channel_pb.SubscriptionCursor,
        waits: RingWaits,
        *,
        newest_only: bool,
    ) -> None:
        self.mapping = mapping
        self.skipped = 0
        self._state, self._waits, self._newest_only = state, waits, newest_only
        self._cursor = channel_pb.SubscriptionCursor()
        self._cursor.CopyFrom(cursor)
        self._begun_seq, self._slot = cursor.next_seq, -1
        self._delivered = 0
        self._slots_max, self._stepped_s = 1, monotonic_s()  # the slots that a step may take

    @property
    def cursor(self) -> channel_pb.SubscriptionCursor:
        """The cursor with which a stream continues after the last item."""
        return self._cursor

    def fits(self) -> bool:
        """Whether the ring has the items and facts that the subscription needs next."""
        if self._cursor.incarnation != self.mapping.view.incarnation:
            return False
        if self._cursor.HasField("from_unix_nano") and not self._newest_only:
            return False  # some of the items before `next_seq` do not belong to the subscription
        facts = self.mapping.view.facts()
        if facts is None or not self.mapping.is_open(boottime_nanos()):
            return False
        if self._newest_only:
            return find_newest(self.mapping.view, facts, self._position) is not True
        return self._next(facts, self._cursor.next_seq, self._slot) is not True

    async def step(self, *, for_batch: bool = False) -> Sequence[Sequence[Item]] | HostMustAnswer:
        """Return the runs of the next items; none after a wait. Raises StampedeError for a damaged ring.

        `for_batch`: the program takes all items of the runs together.
        """
        self._adapt_slots_max(monotonic_s())
        if for_batch:
            self._slots_max = BATCH_SLOTS_MAX
        changes = self.mapping.view.words[CHANGES_WORD]
        facts = self.mapping.view.facts()
        if facts is None:
            return ASK_HOST
        runs = self._take_newest(facts) if self._newest_only else self._take_next(facts)
        if isinstance(runs, HostMustAnswer) or runs:
            return runs
        if not await self._waits.wait(self.mapping, changes, WAIT_S_MAX):
            return ASK_HOST
        return ()

    def _adapt_slots_max(self, now_s: float) -> None:
        """Let a fast reader take twice as many slots as in its last step. A slow reader takes one."""
        is_fast = now_s - self._stepped_s < WINDOW_AGE_S
        self._slots_max = min(2 * self._slots_max, SLOTS_MAX) if is_fast else 1
        self._stepped_s = now_s

    @property
    def _position(self) -> tuple[int, int] | None:
        """The position after which an item counts as new for this subscription; None: every item is new."""
        if not self._cursor.HasField("from_unix_nano"):
            return None
        return self._cursor.from_unix_nano, min(self._cursor.from_seq, _SEQ_MAX) - 1

    def _take_newest(self, facts: list[int]) -> Sequence[Sequence[Item]] | HostMustAnswer:
        found = find_newest(self.mapping.view, facts, self._position)
        if found is True or not self.mapping.is_open(boottime_nanos()):
            return ASK_HOST
        if found is False:
            return ()
        item = newest_item(self._state, self.mapping, found)
        self._cursor.from_unix_nano, self._cursor.from_seq = item.time, item.seq + 1
        self._cursor.next_seq = found.next_seq
        self._delivered += 1
        self.skipped = max(0, given_between(self._begun_seq, found.next_seq) - self._delivered)
        return ((item,),)

    def _take_next(self, facts: list[int]) -> Sequence[Sequence[Item]] | HostMustAnswer:
        """Return the items of each of the next slots, until they have STEP_BYTES_MAX."""
        found, slot, next_seq, taken_bytes = list[FoundNext](), self._slot, self._cursor.next_seq, 0
        while len(found) < self._slots_max and taken_bytes < STEP_BYTES_MAX:
            one = self._next(facts, next_seq, slot)
            if isinstance(one, bool):
                if one and not found:
                    return ASK_HOST
                break
            found.append(one)
            slot, next_seq, taken_bytes = one.slot.number, one.end_seq, taken_bytes + len(one.piece.body)
        if not self.mapping.is_open(boottime_nanos()):
            return ASK_HOST
        runs = [self._items(one) for one in found]
        self._slot, self._cursor.next_seq = slot, next_seq
        return runs

    def _items(self, found: FoundNext) -> Sequence[Item]:
        if found.is_plain:
            return (plain_item(self._state, self.mapping, found.slot, found.piece.body, found.next_time),)
        if not found.piece.is_whole:
            return items_of(self._state, self.mapping, [found.piece], found.next_time, backwards=False)
        decoder = self._state.decoder(self.mapping.view.incarnation, payloads=True)
        return decoder.decode_long([LongRun(memoryview(found.piece.body), found.next_time)])[0]

    def _next(self, facts: list[int], seq: int, slot: int) -> FoundNext | bool:
        now = host_now(facts, boottime_nanos())
        return find_next(self.mapping.view, facts, seq, slot, now, columns_of)
