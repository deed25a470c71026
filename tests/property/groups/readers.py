"""The readers of descriptors in a World's groups, each with an oracle that predicts the answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest

from stampede_rt.errors import IncarnationLost
from stampede_rt.values.timeline import Bound
from stampede_rt_channel_host.core.channel import DeliveredSlice, Gap, PendingGet, Position, Query, SavedCursor, WakeAt
from stampede_rt_channel_host.core.group import Horizon, VisibleAllCursor, VisibleChannel, VisibleNewestCursor
from tests.oracle.channel import Item
from tests.oracle.group import OracleFollower, OracleView
from tests.oracle.reading import OracleReader
from tests.property.channel_pair import ends_as_read, facts, items_of
from tests.property.groups.world import LivingPair, World

BEFORE_ALL = (-(2**64), 0)


@dataclass
class Subscriber:
    """Subscriptions to one channel through one group, in both modes.

    `repeats_loss`: the first step after a resumption may report a loss that was reported before.
    """

    group: int
    channel_id: bytes
    every: VisibleAllCursor
    oracle: OracleFollower
    newest: VisibleNewestCursor
    newest_oracle: OracleFollower
    last: tuple[int, int]
    repeats_loss: bool
    newest_repeats_loss: bool
    meant: int = 0
    last_given: Item | None = None


@dataclass
class Readers:
    """Blocked gets and subscriptions. The methods `end_readers_of_...` end the readers that cannot continue."""

    world: World
    gets: list[tuple[int, bytes, PendingGet]] = field(default_factory=list)
    subscribers: list[Subscriber] = field(default_factory=list)
    seen: dict[int, int] = field(default_factory=dict)  # the highest cut of each group that a reader has seen

    def view(self, group: int, channel_id: bytes) -> tuple[VisibleChannel, Horizon, LivingPair]:
        """The channel as the group shows it, the horizon of its host, and the channel itself."""
        pair = self.world.pair(channel_id)
        OracleReader(pair.oracle, self.world.clock)  # applies the present time to the channel
        return VisibleChannel(pair.core), self.world.host_of(channel_id).horizon(group), pair

    def read(self, group: int, channel_id: bytes, query: Query, at: int | None) -> None:
        """Read at the host's cut, or with the cut that a reader has seen. A host behind this cut shows nothing."""
        view, horizon, pair = self.view(group, channel_id)
        seen = self.seen.get(group)
        if seen is not None and (horizon.cut is None or horizon.cut < seen):
            answer = view.stalled(seen, horizon)
            assert (answer.slices, answer.complete, answer.reason) == ((), False, "HIDDEN")
            return
        if horizon.cut is not None:
            self.seen[group] = horizon.cut
            horizon = horizon if at is None else horizon._replace(cut=min(at, horizon.cut))
        if _is_foreign(query, pair.incarnation):
            with pytest.raises(IncarnationLost):
                view.read(query, horizon, pair.clock)
            return
        self._read(view, horizon, pair, query)

    def _read(self, view: VisibleChannel, horizon: Horizon, pair: LivingPair, query: Query) -> None:
        reader = OracleView(pair.oracle, pair.clock, horizon.cut)
        answer = view.read(query, horizon, pair.clock)
        within = reader.resolve(query)
        expected = reader.read(query, within)
        items = items_of(answer.slices)
        assert facts(items) == facts(expected.items)
        assert all(horizon.cut is not None and item.time < horizon.cut for item in items)
        assert answer.next_time is None or (horizon.cut is not None and answer.next_time < horizon.cut)
        assert ends_as_read(items, answer.next_time, pair.oracle.overlap, answer.next_times) == expected.ends
        assert (answer.interval, answer.complete, answer.truncated, answer.more, answer.incarnation) == (
            within, expected.complete, expected.truncated, expected.more, pair.incarnation,
        )  # fmt: skip
        assert answer.reason == reader.reason(query, within)
        hidden = [one for one in pair.oracle.held if horizon.cut is None or one.time >= horizon.cut]
        assert view.hidden_items(horizon.cut, pair.clock) == len(hidden)
        assert view.window_too_short(horizon.cut, pair.clock) == reader.window_is_too_short

    def begin(self, group: int, channel_id: bytes, query: Query) -> None:
        view, horizon, pair = self.view(group, channel_id)
        if not _is_foreign(query, pair.incarnation):
            self.gets.append((group, channel_id, view.begin(query, horizon, self.world.clock)))

    def poll_all(self) -> None:
        """Poll all blocked gets.

        Each get must end when its answer is due, and may wake only for a change that can release it.
        """
        self.gets = [one for one in self.gets if not self._check_get(*one)]

    def _check_get(self, group: int, channel_id: bytes, pending: PendingGet) -> bool:
        """Poll a get, and check its answer. Returns whether the get has ended."""
        view, horizon, pair = self.view(group, channel_id)
        clock, within = self.world.clock, pending.interval
        reader = OracleView(pair.oracle, clock, horizon.cut)
        answer = view.poll(pending, horizon, clock)
        within = reader.resolve(pending.query) if within is None else within
        assert pending.interval == within
        if within is None:
            assert isinstance(answer, WakeAt)
            assert answer.instant is None
            return False
        expected = reader.read(pending.query, within)
        due = expected.complete or (bool(expected.items) and not pending.query.complete)
        assert isinstance(answer, WakeAt) != due
        if isinstance(answer, WakeAt):
            assert answer.instant == reader.wake_at(within)
            return False
        assert facts(items_of(answer.slices)) == facts(expected.items)
        return True

    def give_up(self) -> None:
        """End the oldest blocked get, because its time is over."""
        if not self.gets:
            return
        group, channel_id, pending = self.gets.pop(0)
        view, horizon, pair = self.view(group, channel_id)
        reader = OracleView(pair.oracle, self.world.clock, horizon.cut)
        answer = view.give_up(pending, horizon, self.world.clock)
        expected = reader.read(pending.query, pending.interval)
        assert facts(items_of(answer.slices)) == facts(expected.items)
        assert answer.reason == reader.reason(pending.query, pending.interval)

    def subscribe(
        self, group: int, channel_id: bytes, start: Bound | None, exclusive: bool, after: Position | None,
        saved: tuple[SavedCursor, SavedCursor] | None = None,
    ) -> Subscriber | None:  # fmt: skip
        """Subscribe from now on, from a bound, or after an item; or continue from `saved`, at `after`."""
        _, horizon, pair = self.view(group, channel_id)
        clock, core, channel, cut = self.world.clock, pair.core, pair.oracle, horizon.cut
        if after is not None and after.incarnation not in (0, pair.incarnation):
            with pytest.raises(IncarnationLost):
                VisibleAllCursor(core, horizon, clock, after=after)
            return None
        reader = OracleView(channel, clock, cut)
        low = reader.instant_of(start) if start is not None and after is None else None
        start = None if after is not None else start
        last = reader.newest_key or BEFORE_ALL
        begin = cut
        if after is not None:
            assert after.seq is not None
            begin, last = None if cut is None else min(cut, after.time + 1), (after.time, after.seq)
        elif start is not None:
            begin = cut if cut is None or low is None else min(cut, low + exclusive)
            last = BEFORE_ALL if low is None else (low, 2**65 if exclusive else -1)
        if saved is not None:
            every = VisibleAllCursor(core, horizon, clock, saved=saved[0])
            newest = VisibleNewestCursor(core, horizon, clock, saved=saved[1])
        else:
            every = VisibleAllCursor(core, horizon, clock, start=start, start_exclusive=exclusive, after=after)
            newest = VisibleNewestCursor(core, horizon, clock, start=start, start_exclusive=exclusive, after=after)
        oracles = [OracleFollower.begin(channel, begin, None if after is None else after.seq) for _ in range(2)]
        repeats_loss = after is not None and has_lost_from(pair, begin)
        made = Subscriber(group, channel_id, every, oracles[0], newest, oracles[1], last, repeats_loss, repeats_loss)
        self.subscribers.append(made)
        return made

    def resume(self, which: int) -> None:
        """Break a subscription during a delivery, and begin it again after the last delivered item."""
        if not self.subscribers:
            return
        one = self.subscribers.pop(which % len(self.subscribers))
        _, horizon, pair = self.view(one.group, one.channel_id)
        one.oracle.owe()
        given = items_of([part.slice for part in one.every.take(horizon, self.world.clock, 1).slices])
        given = given[: 1 + which % max(1, len(given))]
        one.oracle.owed -= {item.seq for item in given}
        last = given[-1] if given else one.last_given
        if last is None:
            return
        position = Position(last.time, last.seq, pair.incarnation)
        made = self.subscribe(one.group, one.channel_id, None, False, position)
        assert made is not None
        held = {item.seq for item in pair.oracle.held}
        assert one.oracle.owed & held <= made.oracle.meant, "each missing item is meant for the reader"
        made.last_given = last

    def resume_by_cursor(self, which: int) -> None:
        """Continue a subscription by its cursor. It must get each item once."""
        if not self.subscribers:
            return
        one = self.subscribers.pop(which % len(self.subscribers))
        every, newest = one.every.saved, one.newest.saved
        assert every is not None
        assert newest is not None
        assert every.cut is not None
        made = self.subscribe(
            one.group,
            one.channel_id,
            None,
            False,
            Position(every.cut - 1, every.next_seq - 1, every.incarnation),
            saved=(every, newest),
        )
        assert made is not None
        made.last = one.last
        held = {item.seq for item in self.world.pair(one.channel_id).oracle.held}
        assert one.oracle.meant & held == made.oracle.meant & held
        made.last_given = one.last_given

    def deliver(self, limit_bytes: int) -> None:
        """Deliver all available items to every subscription."""
        for one in self.subscribers:
            _, horizon, pair = self.view(one.group, one.channel_id)
            self._deliver_newest(one, pair, horizon)
            self._deliver(one, pair, horizon, limit_bytes)

    def _deliver(self, one: Subscriber, pair: LivingPair, horizon: Horizon, limit_bytes: int) -> None:
        oracle, clock = one.oracle, self.world.clock
        if not _may_show_items(oracle, horizon.cut):
            assert one.every.take(horizon, clock, limit_bytes).is_empty
            return
        assert horizon.cut is not None
        oracle.owe()
        items: list[Item] = []
        gaps: list[Gap] = []
        while (part := one.every.take(horizon, clock, limit_bytes)).more or not part.is_empty:
            assert not gaps, "a gap comes after the items of its step"
            items += items_of([each.slice for each in part.slices])
            gaps += [part.gap] if part.gap else []
            check_ends(pair, part.slices, horizon.cut)
        late = [item for item in items if oracle.cut is not None and item.time < oracle.cut]
        assert items[: len(late)] == late
        lost = oracle.end_step(horizon.cut, items[len(late) :], late)
        assert [gap.items for gap in gaps] == ([max(1, len(lost))] if lost or one.repeats_loss else [])
        assert all(gap.first_seq <= seq <= gap.last_seq for gap in gaps for seq in lost)
        one.repeats_loss = False
        one.last_given = items[-1] if items else one.last_given
        assert one.every.lowest_owed_seq(clock) == min([*oracle.owed, len(pair.oracle.log) + 1])

    def _deliver_newest(self, one: Subscriber, pair: LivingPair, horizon: Horizon) -> None:
        reader = OracleView(pair.oracle, self.world.clock, horizon.cut)
        best = reader.newest_key
        part = one.newest.take(horizon, self.world.clock)
        given = [(each.slice.first_time, each.slice.first_seq, each.slice.items) for each in part.slices]
        assert given == ([] if best is None or best <= one.last else [(*best, 1)])
        one.last = best if given and best is not None else one.last
        while part.more:
            part = one.newest.take(horizon, self.world.clock)
            assert part.is_empty
        if _may_show_items(one.newest_oracle, horizon.cut):
            assert horizon.cut is not None
            one.newest_oracle.owe()
            visible = one.newest_oracle.owed & one.newest_oracle.visible(horizon.cut)
            lost = one.newest_oracle.pass_over(horizon.cut) - visible
            one.meant += len(visible) + (max(1, len(lost)) if lost or one.newest_repeats_loss else 0)
            one.newest_repeats_loss = False
        assert one.newest.skipped == max(0, one.meant - one.newest.delivered)

    def end_readers_of_member(self, group: int, channel_id: bytes) -> None:
        """End the readers of the channel through this group, because the channel left the group."""
        self._end(lambda a_group, a_channel: (a_group, a_channel) == (group, channel_id))

    def end_readers_of_channels(self, channel_ids: Sequence[bytes]) -> None:
        """End the readers of channels that moved or were lost, and begin them again."""
        self._end(lambda _, a_channel: a_channel in channel_ids)

    def end_readers_of_groups(self, groups: Sequence[int]) -> None:
        """End the readers of these groups with an error, and begin them again."""
        self._end(lambda group, _: group in groups)
        self.seen = {group: cut for group, cut in self.seen.items() if group not in groups}

    def _end(self, ends: Callable[[int, bytes], bool]) -> None:
        """End the readers of all groups and channels for which `ends` returns True."""
        self.gets = [one for one in self.gets if not ends(one[0], one[1])]
        self.subscribers = [one for one in self.subscribers if not ends(one.group, one.channel_id)]


def _is_foreign(query: Query, incarnation: int) -> bool:
    """Whether the query names an item of another incarnation."""
    positions = [one for one in (query.after, query.newer_than) if one is not None]
    return any(one.incarnation not in (0, incarnation) for one in positions)


def _may_show_items(oracle: OracleFollower, cut: int | None) -> bool:
    if cut is None or (oracle.cut is not None and cut < oracle.cut):
        return False
    return cut != oracle.cut or len(oracle.channel.log) != oracle.seen_seq


def has_lost_from(pair: LivingPair, cut: int | None) -> bool:
    """Whether an item at or past the cut has left the channel."""
    gone = [*pair.oracle.collected_times, *pair.oracle.consumed_times]
    return any(cut is None or time >= cut for time in gone)


def check_ends(pair: LivingPair, slices: Sequence[DeliveredSlice], cut: int) -> None:
    """Check that the last span of each part ends as the visible items require."""
    shown = sorted(one.time for one in pair.oracle.held if one.time < cut)
    for one in slices:
        assert one.next_time == next((time for time in shown if time > one.slice.last_time), None)
