"""The readers of whole groups of a World: cut events and matches, each with an oracle that predicts them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from stampede_rt_channel_host.core.group import (
    OWN,
    Boundary,
    CutFollower,
    EventDecider,
    LocalTrack,
    Loss,
    Matcher,
    OwnChannelTimes,
    RemoteTrack,
    Track,
)
from tests.oracle.channel import Item
from tests.oracle.group import OracleFollower, OracleMatcher
from tests.oracle.reading import OracleReader
from tests.property.channel_pair import items_of
from tests.property.groups.readers import BEFORE_ALL, check_ends, has_lost_from
from tests.property.groups.world import CHANNELS, LivingPair, World

ChangeChannel = Callable[[bytes], None]


@dataclass
class Follower:
    """One channel's part of cut events. The cursor is its state between two steps: a cut, a seq, an incarnation.

    `repeats_loss`: the first step after a resumption may report a loss that was reported before. `uncounted`: the
    items that had left the channel before the resumption, so that no step can count them.
    """

    channel_id: bytes
    core: CutFollower
    oracle: OracleFollower
    cursor: tuple[int | None, int, int]
    repeats_loss: bool = False
    uncounted: set[int] = field(default_factory=set)


@dataclass
class Events:
    """A subscription to a group's cut events.

    One host decides the cuts, and the owner of each channel sends its items.
    """

    group: int
    decider_host: int
    decider: EventDecider
    followers: dict[bytes, Follower]
    decided: int | None
    max_wait: int
    lateness: int
    # cuts that are not decided yet, each with the time at which it was reached
    pending: list[tuple[int, int]] = field(default_factory=list)


@dataclass
class Match:
    """Matches of channel a with b and c. The matcher's host owns a and b, and knows only the keys of the items of c."""

    core: Matcher
    oracle: OracleMatcher
    remote: RemoteTrack
    followed: dict[bytes, OwnChannelTimes]
    start_items: int
    last_seq: int
    taken: int = 0

    def has_passed(self, name: bytes, instant: int) -> bool:
        return self.followed[name].times(1).has_passed(instant, self.oracle.lateness)


@dataclass
class Listeners:
    """All readers of whole groups of a World.

    `take_...` gives all readers of one kind the available events. `channel_moved` and similar methods resume the
    readers after a change.
    """

    world: World
    events: list[Events] = field(default_factory=list)
    matches: list[Match] = field(default_factory=list)

    def pair(self, channel_id: bytes) -> LivingPair:
        """The channel, with the present time applied."""
        pair = self.world.pair(channel_id)
        OracleReader(pair.oracle, self.world.clock)
        return pair

    def subscribe_cuts(self, group: int, host: int, max_wait: int, lateness: int) -> None:
        cut = self.world.hosts[host].cuts[group].cut
        made = Events(group, host, EventDecider(cut, max_wait, lateness), {}, cut, max_wait, lateness)
        for channel_id in self.world.definitions[group].members:
            made.followers[channel_id] = self._follower(channel_id, cut)
        self.events.append(made)

    def _follower(self, channel_id: bytes, cut: int | None) -> Follower:
        pair = self.pair(channel_id)
        core = CutFollower(pair.core, cut, self.world.clock)
        cursor = cut, core.next_seq, pair.incarnation
        return Follower(channel_id, core, OracleFollower.begin(pair.oracle, cut), cursor)

    def note(self) -> None:
        """Let every deciding host note its present cut."""
        for one in self.events:
            cut = self.world.hosts[one.decider_host].cuts[one.group].cut
            last = one.pending[-1][0] if one.pending else one.decided
            if cut is not None and (last is None or cut > last):
                one.pending.append((cut, self.world.clock))
            one.decider.note(cut, self.world.clock)

    def take_events(self, limit_bytes: int, change_channel: ChangeChannel) -> None:
        """Decide the due events: every member has reached the cut, or the longest wait is over.

        Calls `change_channel` between two steps of a channel's part, with the id of the channel.
        """
        for one in self.events:
            host, clock = self.world.hosts[one.decider_host], self.world.clock
            boundary = one.decider.due(list(host.cuts[one.group].members(clock)), clock)
            due = []
            for cut, since in one.pending:
                is_due, behind = host.oracles[one.group].due(cut, since, one.max_wait, one.lateness, clock)
                if not is_due:
                    break
                due.append((cut, behind))
            one.pending = one.pending[len(due) :]
            if one.lateness and one.pending:
                last = due[-1][0] if due else one.decided
                between = host.oracles[one.group].between(last, one.pending[0][0], one.lateness, clock)
                if between is not None:
                    _, behind = host.oracles[one.group].due(between, clock, one.max_wait, one.lateness, clock)
                    due.append((between, behind))
            assert boundary == (Boundary(*due[-1]) if due else None)
            assert one.decider.wake_at() == (one.pending[0][1] + one.max_wait + one.lateness if one.pending else None)
            if boundary is not None:
                one.decided = boundary.cut
                self._take_parts(one, boundary.cut, limit_bytes, change_channel)

    def _take_parts(self, events: Events, cut: int, limit_bytes: int, change_channel: ChangeChannel) -> None:
        """Take each channel's part once the cut at its owner has reached `cut`.

        The cut event does not raise the cut at the owner. Only `exchange` and `look` of the world do.
        """
        for channel_id, one in events.followers.items():
            if not _has_reached(self.world.host_of(channel_id).cuts[events.group].cut, cut):
                self.world.exchange()
                self.world.look()
                self.world.exchange()
                self.world.look()
            assert _has_reached(self.world.host_of(channel_id).cuts[events.group].cut, cut)
            self._take_part(one, cut, limit_bytes, change_channel)

    def _take_part(self, one: Follower, cut: int, limit_bytes: int, change_channel: ChangeChannel) -> None:
        """Take one channel's part. Items that are put between two steps come with the next event."""
        pair = self.pair(one.channel_id)
        one.oracle.owe()
        one.core.begin(cut)
        new: list[Item] = []
        late: list[Item] = []
        while one.core.under_way:
            step = one.core.take(self.world.clock, limit_bytes)
            new += items_of([each.slice for each in step.slices])
            late += items_of([each.slice for each in step.late])
            assert step.is_last != one.core.under_way
            check_ends(pair, step.slices + step.late, cut)
            if one.core.under_way:
                change_channel(one.channel_id)
                OracleReader(pair.oracle, self.world.clock)
        lost = one.oracle.end_step(cut, new, late)
        _check_loss(one, step.loss, lost, pair)
        one.cursor = cut, one.core.next_seq, pair.incarnation
        one.repeats_loss, one.uncounted = False, set()
        assert one.core.cut == cut

    def match(self, tolerance: int, lateness: int, *, unique: bool) -> None:
        a, b, c = (self.world.pair(one) for one in CHANNELS)
        clock = self.world.clock
        OracleReader(a.oracle, clock)
        remote = RemoteTrack()
        remote.add((one.time, one.seq) for one in c.oracle.log.values())
        tracks: dict[bytes, Track] = {b"b": LocalTrack(b.core), b"c": remote}
        position = (a.oracle.newest, len(a.oracle.log)) if a.oracle.newest is not None else BEFORE_ALL
        oracle = OracleMatcher(a.oracle, {b"b": b.oracle, b"c": c.oracle}, tolerance, position, lateness)
        oracle.last = {} if unique else None
        followed = {name: OwnChannelTimes(one.core, clock) for name, one in ((OWN, a), (b"b", b), (b"c", c))}
        core = Matcher(a.core, tracks, tolerance, clock, partners={} if unique else None)
        self.matches.append(Match(core, oracle, remote, followed, len(a.oracle.log), 0))

    def take_matches(self) -> None:
        a, b, c = (self.world.pair(one) for one in CHANNELS)
        clock = self.world.clock
        for one in self.matches:
            one.remote.add((c.oracle.log[seq].time, seq) for seq in range(one.last_seq + 1, len(c.oracle.log) + 1))
            one.last_seq = len(c.oracle.log)
            for pair in (a, b, c):
                OracleReader(pair.oracle, clock)
            for own in one.followed.values():
                own.observe(clock)
            # A reader keeps the keys of the items that it got.
            kept, c.oracle.held = (
                c.oracle.held,
                list(c.oracle.log.values()),
            )
            taken = one.core.take(one.has_passed, clock, 1000)
            wanted = one.oracle.take(1000 if one.oracle.last is None else len(taken))
            assert not one.oracle.is_overdue
            c.oracle.held = kept
            one.taken += len(taken)
            assert [
                (each.item.slice.first_seq, {name: near.seq for name, near in each.matched.items()}) for each in taken
            ] == [(item.seq, {name: near.seq for name, near in found.items()}) for item, found in wanted]
            assert one.core.unmatched == one.oracle.unmatched
            waiting = [item for item in a.oracle.held if (item.time, item.seq) > one.oracle.position]
            assert one.core.dropped == len(a.oracle.log) - one.start_items - one.taken - len(waiting)

    def member_changed(self, group: int, channel_id: bytes, *, joins: bool) -> None:
        """Follow a change of the members.

        An event has the items of a new member from the last decided cut on, and no items of a former member.
        """
        for one in self.events:
            if one.group == group and joins:
                one.followers[channel_id] = self._follower(channel_id, one.decided)
            elif one.group == group:
                one.followers.pop(channel_id, None)

    def channel_moved(self, channel_id: bytes) -> None:
        """Continue at the new owner of the channel."""
        pair = self.pair(channel_id)
        held = {item.seq for item in pair.oracle.held}
        for one in (events.followers.get(channel_id) for events in self.events):
            if one is None:
                continue
            cut, next_seq, incarnation = one.cursor
            one.core = CutFollower(pair.core, cut, self.world.clock, next_seq=next_seq, incarnation=incarnation)
            one.repeats_loss |= has_lost_from(pair, cut)
            if incarnation == pair.incarnation:
                one.uncounted |= {seq for seq in one.oracle.owed if seq < next_seq and seq not in held}

    def channels_lost(self, host: int, channel_ids: Sequence[bytes], successor: int) -> None:
        """Follow the loss of channels: events continue with new items, another host decides, and matches end."""
        self.matches = [] if channel_ids else self.matches
        for events in self.events:
            if events.decider_host == host:
                decider = EventDecider(events.decided, events.max_wait, events.lateness)
                events.decider_host, events.decider, events.pending = successor, decider, []
            for channel_id in set(channel_ids) & events.followers.keys():
                cursor, pair = events.followers[channel_id].cursor, self.world.pair(channel_id)
                cut, next_seq, incarnation = cursor
                core = CutFollower(pair.core, cut, self.world.clock, next_seq=next_seq, incarnation=incarnation)
                oracle = OracleFollower.begin(pair.oracle, cut, 0)
                events.followers[channel_id] = Follower(channel_id, core, oracle, cursor, repeats_loss=True)

    def end_readers_of_groups(self, groups: Sequence[int]) -> None:
        """End all readers of these groups with an error, and begin them again."""
        self.events = [one for one in self.events if one.group not in groups]


def _has_reached(reached: int | None, cut: int) -> bool:
    return reached is not None and reached >= cut


def _check_loss(one: Follower, loss: Loss | None, lost: set[int], pair: LivingPair) -> None:
    """Check the number, the times and the seqs of lost items that were due."""
    assert (loss is not None) == (bool(lost) or one.repeats_loss)
    if loss is None:
        return
    assert loss.is_exact != one.repeats_loss
    assert loss.items == len(lost - one.uncounted)
    assert loss.reason == ("COLLECTED" if one.cursor[2] == pair.incarnation else "LOST")
    assert all(pair.oracle.log[seq].time < loss.before for seq in lost)
    assert all(loss.first_seq <= seq <= loss.last_seq for seq in lost)
