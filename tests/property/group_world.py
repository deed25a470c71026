"""Two hosts with the channels of one group between them, beside an oracle that sees everything at once.

Every channel is a ChannelPair, so that whatever groups do, the original channels go on as their oracle says.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from stampede_rt.model import Policy
from stampede_rt_channel_host.core.channel import DeliveredSlice, Pending, Query, WakeAt
from stampede_rt_channel_host.core.group import (
    Boundary,
    ChannelTimes,
    CutFollower,
    EventDecider,
    FarTrack,
    GroupCut,
    GroupDefinition,
    GroupView,
    Horizon,
    Matcher,
    OwnTimes,
    OwnTrack,
    TimesBoard,
    Track,
    VisibleAll,
    VisibleNewest,
)
from tests.oracle.channel import Item
from tests.oracle.group import OracleFollower, OracleGroup, OracleMatcher, OracleMember, OracleView
from tests.oracle.reading import OracleReader
from tests.property.channel_pair import INCARNATION, ChannelPair, ends_as_read, facts, items_of

CHANNELS = (b"a", b"b", b"c")
EPOCH = 1


@dataclass
class Host:
    """One host: what it owns, and what it knows of the group."""

    owned: list[bytes]
    definition: GroupDefinition
    board: TimesBoard = field(default_factory=TimesBoard)
    cut: GroupCut = field(init=False)
    last_cut: int | None = None

    def __post_init__(self) -> None:
        self.cut = GroupCut(self.definition, self.board)
        self.cut.settle()

    def horizon(self) -> Horizon:
        return Horizon(self.cut.cut, lambda: "somebody holds it back")


@dataclass
class Events:
    """A subscription to cut events: the first host decides, every channel's owner brings its part."""

    decider: EventDecider
    followers: dict[bytes, tuple[CutFollower, OracleFollower]]
    cuts: list[tuple[int, int]]  # taken by the deciding host and not decided yet: the cut, and when
    decided: int | None


@dataclass
class World:
    """`tick`, `put`, ... change it; after each, `look` makes every host look and checks what must always hold."""

    policies: list[Policy]
    definition: GroupDefinition
    split: bool
    clock: int
    pairs: dict[bytes, ChannelPair] = field(init=False)
    own: dict[bytes, OwnTimes] = field(init=False)
    hosts: list[Host] = field(init=False)
    oracle: OracleGroup = field(init=False)
    everybody: dict[bytes, OracleMember] = field(init=False)
    gets: list[tuple[bytes, Pending]] = field(default_factory=list)
    readers: list[tuple[bytes, VisibleAll, OracleFollower]] = field(default_factory=list)
    newest: list[tuple[bytes, VisibleNewest, OracleFollower, list[tuple[int, int]]]] = field(default_factory=list)
    events: list[Events] = field(default_factory=list)
    matchers: list[tuple[Matcher, OracleMatcher, FarTrack, list[int], set[int]]] = field(default_factory=list)
    members_changed: bool = False

    def __post_init__(self) -> None:
        self.pairs = {one: ChannelPair(policy, self.clock) for one, policy in zip(CHANNELS, self.policies, strict=True)}
        self.own = {one: OwnTimes(pair.core, self.clock) for one, pair in self.pairs.items()}
        shares = ([b"a", b"b"], [b"c"]) if self.split else (list(CHANNELS),)
        self.hosts = [Host(share, self.definition) for share in shares]
        self.everybody = {one: OracleMember(pair.oracle, self.clock) for one, pair in self.pairs.items()}
        wanted = self.definition
        self.oracle = OracleGroup(
            {one: self.everybody[one] for one in sorted(wanted.members)},
            wanted.reference, wanted.by_end, wanted.max_lead_nanos, wanted.idle_after_nanos,
        )  # fmt: skip
        self.exchange()
        self.look()

    def host_of(self, channel_id: bytes) -> Host:
        return next(host for host in self.hosts if channel_id in host.owned)

    def view(self, channel_id: bytes) -> tuple[GroupView, Horizon]:
        return GroupView(self.pairs[channel_id].core), self.host_of(channel_id).horizon()

    def spoken(self, channel_id: bytes) -> None:
        """Something was put into the channel, or it advanced."""
        seqs = len(self.pairs[channel_id].oracle.log)
        member = self.everybody[channel_id]
        changed = self.own[channel_id].observe(self.clock)
        member.observe(self.clock, spoke=self.own[channel_id].silent_since == self.clock)
        assert not changed or seqs or member.channel.advanced_to is not None

    def look(self) -> None:
        """Every host takes in what its channels say, and moves its cut; it never moves back or past the truth."""
        self.oracle.observe(self.clock)
        for host in self.hosts:
            for channel_id in host.owned:
                own = self.own[channel_id]
                host.board.tell_own(channel_id, own.times(EPOCH), own.silent_since)
            host.cut.refresh(self.clock)
            cut = host.cut.cut
            assert host.last_cut is None or (cut is not None and cut >= host.last_cut)
            host.last_cut = cut
            if not self.split or self.is_exact:
                assert cut is None or (self.oracle.cut is not None and cut <= self.oracle.cut)
        if not self.split:
            self.check_whole_knowledge()
        for events in self.events:
            self.note(events)

    @property
    def is_exact(self) -> bool:
        """What others tell late never makes a cut too high: ends shrink, and silence is over before it is heard of."""
        return not self.definition.by_end and self.definition.idle_after_nanos is None

    def check_whole_knowledge(self) -> None:
        """A host that owns every channel knows what the oracle knows."""
        cut = self.hosts[0].cut
        assert cut.cut == self.oracle.cut
        assert cut.waiting_on(self.clock) == self.oracle.waiting_on(self.clock)
        for member in cut.members(self.clock):
            assert member.cut == self.oracle.cut_of(member.channel_id)
            assert member.mark == self.everybody[member.channel_id].mark
            assert member.is_idle == self.oracle.is_idle(member.channel_id, self.clock)

    def exchange(self) -> None:
        """What the hosts have to say to each other arrives: times, floors, signs of life."""
        for teller in self.hosts:
            for hearer in self.hosts:
                if hearer is not teller:
                    self.tell(teller, hearer)

    def tell(self, teller: Host, hearer: Host) -> None:
        for channel_id in teller.owned:
            own = self.own[channel_id]
            hearer.board.hear(channel_id, own.times(EPOCH), self.clock - own.silent_since, self.clock)
        hearer.board.confirm(teller.owned, self.clock)
        if teller.cut.cut is not None:
            hearer.cut.merge_floor(teller.cut.cut)

    def agree(self) -> None:
        """Once everything is told, all hosts show the same; and if nothing could be missed on the way, the truth."""
        for _ in range(2):
            self.exchange()
            self.look()
        assert len({host.cut.cut for host in self.hosts}) == 1
        if self.is_exact and not self.members_changed:
            assert self.hosts[0].cut.cut == self.oracle.cut

    def change_member(self, channel_id: bytes, *, joins: bool) -> None:
        """At all hosts at once; the reference and the last member stay."""
        wanted = self.definition.members | {channel_id} if joins else self.definition.members - {channel_id}
        if not wanted or self.definition.reference not in {None, *wanted}:
            return
        self.definition = replace(
            self.definition, members=frozenset(wanted), spec_version=self.definition.spec_version + 1
        )
        self.members_changed = True
        for host in self.hosts:
            host.cut.define(self.definition)
        self.oracle.members = {one: self.everybody[one] for one in sorted(wanted)}

    def stale_words(self, channel_id: bytes) -> None:
        """A former owner says something: it changes nothing."""
        for host in self.hosts:
            far = ChannelTimes(EPOCH - 1, INCARNATION, 2**61, 2**62, 2**61)
            host.board.hear(channel_id, far, 0, self.clock)

    def read(self, channel_id: bytes, query: Query) -> None:
        view, horizon = self.view(channel_id)
        pair = self.pairs[channel_id]
        reader = OracleView(pair.oracle, pair.clock, horizon.cut)
        answer = view.read(query, horizon, pair.clock)
        within = reader.resolve(query)
        expected = reader.read(query, within)
        items = items_of(answer.slices)
        assert facts(items) == facts(expected.items)
        assert all(horizon.cut is not None and item.time < horizon.cut for item in items)
        assert answer.next_time is None or (horizon.cut is not None and answer.next_time < horizon.cut)
        assert ends_as_read(items, answer.next_time) == expected.ends
        assert (answer.interval, answer.complete, answer.truncated, answer.more) == (
            within, expected.complete, expected.truncated, expected.more,
        )  # fmt: skip
        assert answer.reason == reader.reason(query, within)

    def begin(self, channel_id: bytes, query: Query) -> None:
        view, horizon = self.view(channel_id)
        self.gets.append((channel_id, view.begin(query, horizon, self.clock)))

    def poll_all(self) -> None:
        """A blocked get is released as soon as an answer is due, and wakes for nothing but what can bring one."""
        still = []
        for channel_id, pending in self.gets:
            view, horizon = self.view(channel_id)
            reader = OracleView(self.pairs[channel_id].oracle, self.clock, horizon.cut)
            answer = view.poll(pending, horizon, self.clock)
            within = pending.interval
            if within is None:
                assert isinstance(answer, WakeAt)
                still.append((channel_id, pending))
                continue
            expected = reader.read(pending.query, within)
            due = expected.complete or (bool(expected.items) and not pending.query.complete)
            assert isinstance(answer, WakeAt) != due
            if isinstance(answer, WakeAt):
                assert answer.instant is None or answer.instant > self.clock
                still.append((channel_id, pending))
            else:
                assert facts(items_of(answer.slices)) == facts(expected.items)
        self.gets = still

    def subscribe(self, channel_id: bytes) -> None:
        """To what becomes visible from now on, in both modes."""
        _, horizon = self.view(channel_id)
        pair = self.pairs[channel_id]
        OracleReader(pair.oracle, self.clock)
        shown = [one for one in pair.oracle.held if horizon.cut is not None and one.time < horizon.cut]
        last = max(((one.time, one.seq) for one in shown), default=(-(2**64), 0))
        every, newest = VisibleAll(pair.core, horizon, self.clock), VisibleNewest(pair.core, horizon, self.clock)
        self.readers.append((channel_id, every, OracleFollower.begin(pair.oracle, horizon.cut)))
        self.newest.append((channel_id, newest, OracleFollower.begin(pair.oracle, horizon.cut), [last]))

    def deliver(self, limit_bytes: int) -> None:
        """Every subscription through the group takes what there is."""
        for channel_id, reader, follower in self.readers:
            self._deliver(channel_id, reader, follower, limit_bytes)
        for channel_id, newest, _, last in self.newest:
            _, horizon = self.view(channel_id)
            pair = self.pairs[channel_id]
            OracleReader(pair.oracle, self.clock)
            shown = [one for one in pair.oracle.held if horizon.cut is not None and one.time < horizon.cut]
            best = max(((one.time, one.seq) for one in shown), default=(-(2**64), 0))
            given = newest.take(horizon, self.clock)
            assert (given is None) == (best <= last[0])
            if given is not None:
                assert (given.slice.first_time, given.slice.first_seq) == best
                last[0] = best

    def _deliver(self, channel_id: bytes, reader: VisibleAll, follower: OracleFollower, limit_bytes: int) -> None:
        _, horizon = self.view(channel_id)
        pair = self.pairs[channel_id]
        OracleReader(pair.oracle, self.clock)
        if horizon.cut is None or (horizon.cut == follower.cut and len(pair.oracle.log) == follower.seen_seq):
            assert reader.take(horizon, self.clock, limit_bytes).is_empty
            return
        follower.owe(len(pair.oracle.log))
        items: list[Item] = []
        missed = 0
        while not (part := reader.take(horizon, self.clock, limit_bytes)).is_empty:
            items += items_of([one.slice for one in part.slices])
            missed += part.gap.items if part.gap else 0
            self._check_ends(pair, part.slices, horizon.cut)
        late = [one for one in items if follower.cut is not None and one.time < follower.cut]
        lost = follower.end_step(horizon.cut, [one for one in items if one not in late], late)
        assert missed == lost
        assert items[: len(late)] == late
        assert reader.lowest_owed_seq(self.clock) == min([*follower.owed, len(pair.oracle.log) + 1])

    def _check_ends(self, pair: ChannelPair, slices: object, cut: int) -> None:
        """Each part's last span ends where it does among what is visible."""
        shown = sorted(one.time for one in pair.oracle.held if one.time < cut)
        assert isinstance(slices, list | tuple)
        for one in slices:
            assert isinstance(one, DeliveredSlice)
            assert one.next_time == next((time for time in shown if time > one.slice.last_time), None)

    def subscribe_cuts(self, max_wait: int) -> None:
        host = self.hosts[0]
        cut = host.cut.cut
        followers = {}
        for channel_id in self.definition.members:
            pair = self.pairs[channel_id]
            OracleReader(pair.oracle, self.clock)
            follower = CutFollower(pair.core, cut, self.clock)
            followers[channel_id] = follower, OracleFollower.begin(pair.oracle, cut)
        self.events.append(Events(EventDecider(cut, max_wait), followers, [], cut))

    def note(self, events: Events) -> None:
        """The deciding host looks: an event is due when every member is as far, or the wait is over."""
        host = self.hosts[0]
        cut = host.cut.cut
        last = events.cuts[-1][0] if events.cuts else events.decided
        if cut is not None and (last is None or cut > last):
            events.cuts.append((cut, self.clock))
        events.decider.note(cut, self.clock)

    def take_events(self, max_wait: int, limit_bytes: int) -> None:
        for events in self.events:
            host = self.hosts[0]
            members = list(host.cut.members(self.clock))
            boundary = events.decider.due(members, self.clock)
            due = []
            for cut, since in events.cuts:
                behind = [one for one in members if one.mark is None or one.mark < cut]
                if self.clock < since + max_wait and [one for one in behind if not one.is_idle]:
                    break
                due.append((cut, tuple(one.channel_id for one in behind)))
            assert boundary == (Boundary(*due[-1]) if due else None)
            if boundary is not None:
                events.cuts = events.cuts[len(due) :]
                events.decided = boundary.cut
                self._take_parts(events, boundary.cut, limit_bytes)
            assert events.decider.wake_at() == (events.cuts[0][1] + max_wait if events.cuts else None)

    def _take_parts(self, events: Events, cut: int, limit_bytes: int) -> None:
        """Each channel's part, once its owner's cut is there, which the reader's word has not raised."""
        for channel_id, (follower, expected) in list(events.followers.items()):
            if channel_id not in self.definition.members:
                continue
            if (own := self.host_of(channel_id).cut.cut) is None or own < cut:
                self.exchange()
                self.look()
            pair = self.pairs[channel_id]
            OracleReader(pair.oracle, self.clock)
            expected.owe(len(pair.oracle.log))
            follower.begin(cut)
            new: list[Item] = []
            late: list[Item] = []
            while True:
                step = follower.take(self.clock, limit_bytes)
                new += items_of([one.slice for one in step.slices])
                late += items_of([one.slice for one in step.late])
                if step.is_last:
                    break
            lost = expected.end_step(cut, new, late)
            assert (step.loss.items if step.loss else 0) == lost
            assert follower.cut == cut
            if lost % 2:  # the same reader goes on in another process, with nothing but its place
                follower = CutFollower(pair.core, cut, self.clock, next_seq=follower.next_seq, incarnation=INCARNATION)
                assert not follower.under_way

    def match(self, tolerance: int) -> None:
        """Channel a against b, which is at the same host, and c, of which only places are told."""
        pair = self.pairs[b"a"]
        OracleReader(pair.oracle, self.clock)
        far = FarTrack()
        far.add((one.time, one.seq) for one in self.pairs[b"c"].oracle.log.values())
        tracks: dict[bytes, Track] = {b"b": OwnTrack(self.pairs[b"b"].core), b"c": far}
        place = (pair.oracle.newest, len(pair.oracle.log)) if pair.oracle.held else (-(2**64), 0)
        assert place[0] is not None
        matcher = Matcher(pair.core, tracks, tolerance, self.clock)
        others = {one: self.everybody[one] for one in (b"b", b"c")}
        expected = OracleMatcher(pair.oracle, others, tolerance, (place[0], place[1]))
        seqs = {len(self.pairs[b"c"].oracle.log)}
        self.matchers.append((matcher, expected, far, [len(pair.oracle.log)], seqs))

    def take_matches(self) -> None:
        for matcher, expected, far, begun, seen in self.matchers:
            log = self.pairs[b"c"].oracle.log
            far.add((log[seq].time, seq) for seq in range(max(seen) + 1, len(log) + 1))
            seen.add(len(log))
            for one in (b"a", b"b", b"c"):
                OracleReader(self.pairs[one].oracle, self.clock)
            kept = self.pairs[b"c"].oracle.held
            self.pairs[b"c"].oracle.held = list(log.values())  # places stay with those who were told them
            taken = matcher.take(lambda one, at: self.own[one].times(EPOCH).has_passed(at), self.clock, 1000)
            wanted = expected.take()
            self.pairs[b"c"].oracle.held = kept
            given = [
                (one.item.slice.first_seq, {name: near.seq for name, near in one.matched.items()}) for one in taken
            ]
            assert given == [(item.seq, {name: near.seq for name, near in found.items()}) for item, found in wanted]
            assert matcher.unmatched == expected.unmatched
            begun.append(len(taken))
            total = len(self.pairs[b"a"].oracle.log) - begun[0]
            waiting = [one for one in self.pairs[b"a"].oracle.held if (one.time, one.seq) > expected.place]
            assert matcher.dropped == total - sum(begun[1:]) - len(waiting)

    def check(self) -> None:
        """The original channels are as if there were no group."""
        for pair in self.pairs.values():
            pair.check()
