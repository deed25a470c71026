"""Whoever reads through the groups of a World, each beside an oracle that says what it must be told."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import pytest

from stampede_rt.errors import IncarnationLost
from stampede_rt.timeline import Bound
from stampede_rt_channel_host.core.channel import DeliveredSlice, Gap, Pending, Position, Query, WakeAt
from stampede_rt_channel_host.core.group import (
    Boundary,
    CutFollower,
    EventDecider,
    FarTrack,
    GroupView,
    Horizon,
    Loss,
    Matcher,
    OwnTimes,
    OwnTrack,
    Track,
    VisibleAll,
    VisibleNewest,
)
from tests.oracle.channel import Item
from tests.oracle.group import OracleFollower, OracleMatcher, OracleView
from tests.oracle.reading import OracleReader
from tests.property.channel_pair import ends_as_read, facts, items_of
from tests.property.group_world import CHANNELS, LivingPair, World

BEFORE_ALL = (-(2**64), 0)

Meddle = Callable[[bytes], None]


@dataclass
class Follower:
    """One channel's part of cut events. The cursor is what is kept of it between steps: a cut, a seq, an incarnation.

    `hears_again`: the first step after it was resumed tells that items are gone, though it may have been told before.
    `uncounted`: what was gone by then, so that nobody can count it.
    """

    channel_id: bytes
    core: CutFollower
    oracle: OracleFollower
    cursor: tuple[int | None, int, int]
    hears_again: bool = False
    uncounted: set[int] = field(default_factory=set)


@dataclass
class Events:
    """A subscription to a group's cut events: one host decides, every channel's owner brings its part."""

    group: int
    decider_host: int
    decider: EventDecider
    followers: dict[bytes, Follower]
    decided: int | None
    max_wait: int
    pending: list[tuple[int, int]] = field(default_factory=list)  # cuts that are not decided yet, and since when


@dataclass
class Subscriber:
    """Of one channel through one group, in both modes; `hears_again` as in `Follower`."""

    group: int
    channel_id: bytes
    every: VisibleAll
    oracle: OracleFollower
    newest: VisibleNewest
    of_newest: OracleFollower
    last: tuple[int, int]
    hears_again: bool
    newest_hears_again: bool
    meant: int = 0
    last_given: Item | None = None


@dataclass
class Match:
    """Channel a against b, at the same host as the matcher, and c, of which only places are told."""

    core: Matcher
    oracle: OracleMatcher
    far: FarTrack
    followed: dict[bytes, OwnTimes]
    begun: int
    told: int
    taken: int = 0


@dataclass
class Readers:
    """`take_...` lets all of a kind take what there is; `channel_moved` and the like end and resume them."""

    world: World
    gets: list[tuple[int, bytes, Pending]] = field(default_factory=list)
    subscribers: list[Subscriber] = field(default_factory=list)
    events: list[Events] = field(default_factory=list)
    matches: list[Match] = field(default_factory=list)
    seen: dict[int, int] = field(default_factory=dict)  # the highest cut of each group that a reader was shown

    def view(self, group: int, channel_id: bytes) -> tuple[GroupView, Horizon, LivingPair]:
        pair = self.world.pair(channel_id)
        OracleReader(pair.oracle, self.world.clock)  # ages it
        return GroupView(pair.core), self.world.host_of(channel_id).horizon(group), pair

    def read(self, group: int, channel_id: bytes, query: Query, at: int | None) -> None:
        """At the host's cut or at an earlier one; a host that is behind what the reader saw shows nothing."""
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

    def _read(self, view: GroupView, horizon: Horizon, pair: LivingPair, query: Query) -> None:
        reader = OracleView(pair.oracle, pair.clock, horizon.cut)
        answer = view.read(query, horizon, pair.clock)
        within = reader.resolve(query)
        expected = reader.read(query, within)
        items = items_of(answer.slices)
        assert facts(items) == facts(expected.items)
        assert all(horizon.cut is not None and item.time < horizon.cut for item in items)
        assert answer.next_time is None or (horizon.cut is not None and answer.next_time < horizon.cut)
        assert ends_as_read(items, answer.next_time) == expected.ends
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
        """A blocked get is released as soon as an answer is due, and wakes for nothing but what can bring one."""
        self.gets = [one for one in self.gets if not self._is_released(*one)]

    def _is_released(self, group: int, channel_id: bytes, pending: Pending) -> bool:
        view, horizon, pair = self.view(group, channel_id)
        clock, within = self.world.clock, pending.interval
        reader = OracleView(pair.oracle, clock, horizon.cut)
        answer = view.poll(pending, horizon, clock)
        within = reader.resolve(pending.query) if within is None else within
        assert pending.interval == within
        if within is None:
            assert answer == WakeAt(None)
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
        """The oldest blocked get's time is over."""
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
        self, group: int, channel_id: bytes, start: Bound | None, exclusive: bool, after: Position | None
    ) -> Subscriber | None:
        """To what becomes visible from now on, from a bound on, or behind an item."""
        _, horizon, pair = self.view(group, channel_id)
        clock, core, channel, cut = self.world.clock, pair.core, pair.oracle, horizon.cut
        if after is not None and after.incarnation not in (0, pair.incarnation):
            with pytest.raises(IncarnationLost):
                VisibleAll(core, horizon, clock, after=after)
            return None
        reader = OracleView(channel, clock, cut)
        low = reader.instant_of(start) if start is not None and after is None else None
        start = None if after is not None else start
        last = reader.newest_place or BEFORE_ALL
        begin = cut
        if after is not None:
            assert after.seq is not None
            begin, last = None if cut is None else min(cut, after.time + 1), (after.time, after.seq)
        elif start is not None:
            begin = cut if cut is None or low is None else min(cut, low + exclusive)
            last = BEFORE_ALL if low is None else (low, 2**65 if exclusive else -1)
        every = VisibleAll(core, horizon, clock, start=start, start_exclusive=exclusive, after=after)
        newest = VisibleNewest(core, horizon, clock, start=start, start_exclusive=exclusive, after=after)
        oracles = [OracleFollower.begin(channel, begin, None if after is None else after.seq) for _ in range(2)]
        again = after is not None and _has_lost_from(pair, begin)
        made = Subscriber(group, channel_id, every, oracles[0], newest, oracles[1], last, again, again)
        self.subscribers.append(made)
        return made

    def resume(self, which: int) -> None:
        """A subscriber breaks off amid a delivery, and begins again behind the last item that it was given."""
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
        assert one.oracle.owed & held <= made.oracle.meant, "whatever it has not been given is still meant for it"
        made.last_given = last

    def deliver(self, limit_bytes: int) -> None:
        """Every subscription through the groups takes what there is."""
        for one in self.subscribers:
            _, horizon, pair = self.view(one.group, one.channel_id)
            self._deliver_newest(one, pair, horizon)
            self._deliver(one, pair, horizon, limit_bytes)

    def _deliver(self, one: Subscriber, pair: LivingPair, horizon: Horizon, limit_bytes: int) -> None:
        oracle, clock = one.oracle, self.world.clock
        if not _has_news(oracle, horizon.cut):
            assert one.every.take(horizon, clock, limit_bytes).is_empty
            return
        assert horizon.cut is not None
        oracle.owe()
        items: list[Item] = []
        gaps: list[Gap] = []
        while not (part := one.every.take(horizon, clock, limit_bytes)).is_empty:
            assert not gaps, "a gap comes behind the items of its step"
            items += items_of([each.slice for each in part.slices])
            gaps += [part.gap] if part.gap else []
            _check_ends(pair, part.slices, horizon.cut)
        late = [item for item in items if oracle.cut is not None and item.time < oracle.cut]
        assert items[: len(late)] == late
        lost = oracle.end_step(horizon.cut, items[len(late) :], late)
        assert [gap.items for gap in gaps] == ([max(1, len(lost))] if lost or one.hears_again else [])
        assert all(gap.first_seq <= seq <= gap.last_seq for gap in gaps for seq in lost)
        one.hears_again = False
        one.last_given = items[-1] if items else one.last_given
        assert one.every.lowest_owed_seq(clock) == min([*oracle.owed, len(pair.oracle.log) + 1])

    def _deliver_newest(self, one: Subscriber, pair: LivingPair, horizon: Horizon) -> None:
        reader = OracleView(pair.oracle, self.world.clock, horizon.cut)
        best = reader.newest_place
        given = one.newest.take(horizon, self.world.clock)
        if best is None or best <= one.last:
            assert given is None
        else:
            assert given is not None
            assert (given.slice.first_time, given.slice.first_seq, given.slice.items) == (*best, 1)
            one.last = best
        if _has_news(one.of_newest, horizon.cut):
            assert horizon.cut is not None
            one.of_newest.owe()
            visible = one.of_newest.owed & one.of_newest.visible(horizon.cut)
            lost = one.of_newest.pass_over(horizon.cut) - visible
            one.meant += len(visible) + (max(1, len(lost)) if lost or one.newest_hears_again else 0)
            one.newest_hears_again = False
        assert one.newest.skipped == max(0, one.meant - one.newest.delivered)

    def subscribe_cuts(self, group: int, host: int, max_wait: int) -> None:
        cut = self.world.hosts[host].cuts[group].cut
        made = Events(group, host, EventDecider(cut, max_wait), {}, cut, max_wait)
        for channel_id in self.world.definitions[group].members:
            made.followers[channel_id] = self._follower(channel_id, cut)
        self.events.append(made)

    def _follower(self, channel_id: bytes, cut: int | None) -> Follower:
        _, _, pair = self.view(0, channel_id)
        core = CutFollower(pair.core, cut, self.world.clock)
        cursor = cut, core.next_seq, pair.incarnation
        return Follower(channel_id, core, OracleFollower.begin(pair.oracle, cut), cursor)

    def note(self) -> None:
        """Every deciding host looks where its cut is."""
        for one in self.events:
            cut = self.world.hosts[one.decider_host].cuts[one.group].cut
            last = one.pending[-1][0] if one.pending else one.decided
            if cut is not None and (last is None or cut > last):
                one.pending.append((cut, self.world.clock))
            one.decider.note(cut, self.world.clock)

    def take_events(self, limit_bytes: int, meddle: Meddle) -> None:
        """An event is due when every member is as far, or the wait is over. `meddle` comes between an event's parts."""
        for one in self.events:
            host, clock = self.world.hosts[one.decider_host], self.world.clock
            boundary = one.decider.due(list(host.cuts[one.group].members(clock)), clock)
            due = []
            for cut, since in one.pending:
                is_due, behind = host.oracles[one.group].due(cut, since, one.max_wait, clock)
                if not is_due:
                    break
                due.append((cut, behind))
            assert boundary == (Boundary(*due[-1]) if due else None)
            one.pending = one.pending[len(due) :]
            assert one.decider.wake_at() == (one.pending[0][1] + one.max_wait if one.pending else None)
            if boundary is not None:
                one.decided = boundary.cut
                self._take_parts(one, boundary.cut, limit_bytes, meddle)

    def _take_parts(self, events: Events, cut: int, limit_bytes: int, meddle: Meddle) -> None:
        """Each channel's part, once its owner's cut is there, which the reader's word does not raise."""
        for channel_id, one in events.followers.items():
            if not _has_come_to(self.world.host_of(channel_id).cuts[events.group].cut, cut):
                self.world.exchange()
                self.world.look()
                self.world.exchange()
                self.world.look()
            assert _has_come_to(self.world.host_of(channel_id).cuts[events.group].cut, cut)
            self._take_part(one, cut, limit_bytes, meddle)

    def _take_part(self, one: Follower, cut: int, limit_bytes: int, meddle: Meddle) -> None:
        """What is put between two of its steps comes with the next event."""
        _, _, pair = self.view(0, one.channel_id)
        one.oracle.owe()
        one.core.begin(cut)
        new: list[Item] = []
        late: list[Item] = []
        while one.core.under_way:
            step = one.core.take(self.world.clock, limit_bytes)
            new += items_of([each.slice for each in step.slices])
            late += items_of([each.slice for each in step.late])
            assert step.is_last != one.core.under_way
            _check_ends(pair, step.slices + step.late, cut)
            if one.core.under_way:
                meddle(one.channel_id)
                OracleReader(pair.oracle, self.world.clock)
        lost = one.oracle.end_step(cut, new, late)
        _check_loss(one, step.loss, lost, pair)
        one.cursor = cut, one.core.next_seq, pair.incarnation
        one.hears_again, one.uncounted = False, set()
        assert one.core.cut == cut

    def match(self, tolerance: int) -> None:
        a, b, c = (self.world.pair(one) for one in CHANNELS)
        clock = self.world.clock
        OracleReader(a.oracle, clock)
        far = FarTrack()
        far.add((one.time, one.seq) for one in c.oracle.log.values())
        tracks: dict[bytes, Track] = {b"b": OwnTrack(b.core), b"c": far}
        place = (a.oracle.newest, len(a.oracle.log)) if a.oracle.newest is not None else BEFORE_ALL
        oracle = OracleMatcher(a.oracle, {b"b": b.oracle, b"c": c.oracle}, tolerance, place)
        followed = {b"b": OwnTimes(b.core, clock), b"c": OwnTimes(c.core, clock)}
        made = Match(Matcher(a.core, tracks, tolerance, clock), oracle, far, followed, len(a.oracle.log), 0)
        self.matches.append(made)

    def take_matches(self) -> None:
        a, b, c = (self.world.pair(one) for one in CHANNELS)
        clock = self.world.clock
        for one in self.matches:
            one.far.add((c.oracle.log[seq].time, seq) for seq in range(one.told + 1, len(c.oracle.log) + 1))
            one.told = len(c.oracle.log)
            for pair in (a, b, c):
                OracleReader(pair.oracle, clock)
            for own in one.followed.values():
                own.observe(clock)
            kept, c.oracle.held = c.oracle.held, list(c.oracle.log.values())  # places stay with those they were told
            taken = one.core.take(lambda name, at: one.followed[name].times(1).has_passed(at), clock, 1000)  # noqa: B023
            wanted = one.oracle.take()
            c.oracle.held = kept
            one.taken += len(taken)
            assert [
                (each.item.slice.first_seq, {name: near.seq for name, near in each.matched.items()}) for each in taken
            ] == [(item.seq, {name: near.seq for name, near in found.items()}) for item, found in wanted]
            assert one.core.unmatched == one.oracle.unmatched
            waiting = [item for item in a.oracle.held if (item.time, item.seq) > one.oracle.place]
            assert one.core.dropped == len(a.oracle.log) - one.begun - one.taken - len(waiting)

    def member_changed(self, group: int, channel_id: bytes, *, joins: bool) -> None:
        """Readers of a channel that left end; events of a group that it joined bring it, from their cut on."""
        for one in self.events:
            if one.group == group and joins:
                one.followers[channel_id] = self._follower(channel_id, one.decided)
            elif one.group == group:
                one.followers.pop(channel_id, None)
        if not joins:
            self._end(lambda a_group, a_channel: (a_group, a_channel) == (group, channel_id))

    def channel_moved(self, channel_id: bytes) -> None:
        """The same channel at another host: events go on there, other readers begin again by themselves."""
        self._end(lambda _, a_channel: a_channel == channel_id)
        pair = self.world.pair(channel_id)
        OracleReader(pair.oracle, self.world.clock)
        held = {item.seq for item in pair.oracle.held}
        for one in (events.followers.get(channel_id) for events in self.events):
            if one is None:
                continue
            cut, next_seq, incarnation = one.cursor
            one.core = CutFollower(pair.core, cut, self.world.clock, next_seq=next_seq, incarnation=incarnation)
            one.hears_again |= _has_lost_from(pair, cut)
            if incarnation == pair.incarnation:
                one.uncounted |= {seq for seq in one.oracle.owed if seq < next_seq and seq not in held}

    def channels_lost(self, host: int, channel_ids: Sequence[bytes], heir: int) -> None:
        """Nothing of them is left. Events go on with what comes, another host decides, and matches end."""
        self._end(lambda _, a_channel: a_channel in channel_ids)
        self.matches = [] if channel_ids else self.matches
        for events in self.events:
            if events.decider_host == host:
                decider = EventDecider(events.decided, events.max_wait)
                events.decider_host, events.decider, events.pending = heir, decider, []
            for channel_id in set(channel_ids) & events.followers.keys():
                cursor, pair = events.followers[channel_id].cursor, self.world.pair(channel_id)
                cut, next_seq, incarnation = cursor
                core = CutFollower(pair.core, cut, self.world.clock, next_seq=next_seq, incarnation=incarnation)
                oracle = OracleFollower.begin(pair.oracle, cut, 0)
                events.followers[channel_id] = Follower(channel_id, core, oracle, cursor, hears_again=True)

    def groups_began_anew(self, groups: Sequence[int]) -> None:
        """Their readers hear of it, and begin again by themselves."""
        self._end(lambda group, _: group in groups)
        self.events = [one for one in self.events if one.group not in groups]
        self.seen = {group: cut for group, cut in self.seen.items() if group not in groups}

    def _end(self, ends: Callable[[int, bytes], bool]) -> None:
        """Those of a group and a channel that it ends."""
        self.gets = [one for one in self.gets if not ends(one[0], one[1])]
        self.subscribers = [one for one in self.subscribers if not ends(one.group, one.channel_id)]


def _is_foreign(query: Query, incarnation: int) -> bool:
    """It names a place of another life of the channel."""
    positions = [one for one in (query.after, query.newer_than) if one is not None]
    return any(one.incarnation not in (0, incarnation) for one in positions)


def _has_come_to(reached: int | None, cut: int) -> bool:
    return reached is not None and reached >= cut


def _has_news(oracle: OracleFollower, cut: int | None) -> bool:
    if cut is None or (oracle.cut is not None and cut < oracle.cut):
        return False
    return cut != oracle.cut or len(oracle.channel.log) != oracle.seen_seq


def _has_lost_from(pair: LivingPair, cut: int | None) -> bool:
    """Some item at or past the cut is gone."""
    gone = [*pair.oracle.collected_times, *pair.oracle.consumed_times]
    return any(cut is None or time >= cut for time in gone)


def _check_ends(pair: LivingPair, slices: Sequence[DeliveredSlice], cut: int) -> None:
    """Each part's last span ends where it does among what is visible."""
    shown = sorted(one.time for one in pair.oracle.held if one.time < cut)
    for one in slices:
        assert one.next_time == next((time for time in shown if time > one.slice.last_time), None)


def _check_loss(one: Follower, loss: Loss | None, lost: set[int], pair: LivingPair) -> None:
    """What was due and is gone is counted, and bounded in time and in seqs."""
    assert (loss is not None) == (bool(lost) or one.hears_again)
    if loss is None:
        return
    assert loss.is_exact != one.hears_again
    assert loss.items == len(lost - one.uncounted)
    assert loss.reason == ("COLLECTED" if one.cursor[2] == pair.incarnation else "LOST")
    assert all(pair.oracle.log[seq].time < loss.before for seq in lost)
    assert all(loss.first_seq <= seq <= loss.last_seq for seq in lost)
